"""The watchdog's process on a machine where all but the first opening of its link takes long.

    python slow_opening.py FREE SECONDS ARGUMENTS_OF_THE_WATCHDOG

So many openings are as quick as ever; then a name is looked up, or a device opened, for so long,
and in vain: as where the network that has the link has the name server too, or a USB hub hangs.
"""

import os
import socket
import sys
import time

from vwnav.watchdog.launch import main

FREE, SECONDS = int(sys.argv[1]), float(sys.argv[2])
_look_up, _open = socket.getaddrinfo, os.open
_done = 0


def _is_slow() -> bool:
    global _done
    _done += 1
    if _done <= FREE:
        return False
    time.sleep(SECONDS)
    return True


def look_up(*arguments, **more):
    if _is_slow():
        raise socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")
    return _look_up(*arguments, **more)


def open_device(path, *arguments, **more):
    if str(path).endswith("/tty") and _is_slow():
        raise OSError(19, "No such device")
    return _open(path, *arguments, **more)


socket.getaddrinfo = look_up
os.open = open_device
sys.exit(main(sys.argv[3:]))
