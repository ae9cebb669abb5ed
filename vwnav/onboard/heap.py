"""What was freed goes back to the system."""

import ctypes
import threading
import time

_EVERY_S = 60.0


def give_back_free_memory() -> bool:
    """Give every free page of the C library's heap back (malloc_trim(3)); False without glibc.

    Left alone, glibc takes the first large block that is freed as a sign to cut those to come out
    of its heap, up to 32 MB (mallopt(3), M_MMAP_THRESHOLD). Their sizes differ from image to
    image, and the holes that they leave between what stays are never given back.
    """
    malloc_trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if malloc_trim is None:
        return False
    malloc_trim(0)
    return True


def keep_heap_small() -> None:
    """Give it back once a minute from now on, in a thread of its own."""
    threading.Thread(target=_every_minute, name="heap", daemon=True).start()


def _every_minute() -> None:
    while give_back_free_memory():
        time.sleep(_EVERY_S)
