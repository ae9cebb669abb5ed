"""Memory does not grow in flight: what is kept anyway is taken before, what is freed goes back."""

import ctypes
import threading
import time

import numpy as np

_EVERY_S = 60.0
# Blocks that numpy keeps when they are freed, of each size (`NCACHE`, `NBUCKETS` of its
# multiarray/alloc.c); the process has one such cache.
_KEPT_BLOCKS, _LARGEST_KEPT_BYTES = 7, 1023


def fill_array_cache() -> None:
    """Let numpy take all that it keeps of small arrays, 3.7 MB.

    Of what an image shows there are as many tracks and matches as there are, each number of them a
    size of its own: left alone, the cache fills by 1 to 2 MB in an hour of flight.
    """
    for size in range(1, _LARGEST_KEPT_BYTES + 1):
        _ = [np.empty(size, np.uint8) for _ in range(_KEPT_BLOCKS)]


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
    """Take what is kept anyway; give back the rest once a minute, in a thread of its own."""
    fill_array_cache()
    threading.Thread(target=_every_minute, name="heap", daemon=True).start()


def _every_minute() -> None:
    while give_back_free_memory():
        time.sleep(_EVERY_S)
