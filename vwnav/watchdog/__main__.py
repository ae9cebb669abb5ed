"""`python -m vwnav.watchdog` is the watchdog's process."""

import sys

from vwnav.watchdog.launch import main

if __name__ == "__main__":
    sys.exit(main())
