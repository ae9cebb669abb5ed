"""Files as text: tables read, files written whole or not at all."""
