"""Files and folders: tables read, what lies in a folder, files written whole or not at all."""
