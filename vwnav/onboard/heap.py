"""Large blocks of memory go back to the system when they are freed."""

import ctypes

_M_MMAP_THRESHOLD = -3  # malloc.h
_LARGE_BYTES = 1_000_000  # pictures, pieces of map, tables of distances


def return_large_blocks() -> bool:
    """Have the C library map every large block by itself; False where it cannot be told to.

    Left alone, glibc takes the first large one that is freed as a sign to cut those to come out of
    its heap, up to 32 MB (mallopt(3), M_MMAP_THRESHOLD). Their sizes differ from picture to
    picture, and the holes that they leave between what stays are never given back.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    return mallopt is not None and bool(mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES))
