"""`python -m vwnav` is the command `vwnav`."""

from vwnav.cli.main import main

main()
