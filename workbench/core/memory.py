"""Setting of the C library that keeps freed memory for later arrays; made once per program."""

import ctypes
import sys

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # glibc's malloc.h
KEPT = 256 << 20
"""Bytes that may stay with the process."""
LARGEST = 32 << 20
"""Bytes of the largest array that is kept, the most that glibc allows."""


def keep_freed_memory() -> bool:
    """Ask glibc not to give freed memory back at once; False where there is no glibc.

    A solve frees and wants the same few megabytes at every step. Getting fresh pages from the
    system took four fifths of the time of a Jacobian of 7,000 samples.
    """
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    return mallopt is not None and bool(
        mallopt(_MMAP_THRESHOLD, LARGEST) and mallopt(_TRIM_THRESHOLD, KEPT)
    )


def release_freed_memory() -> bool:
    """Give all freed memory back to the system, before other processes need it; False where there is no glibc."""
    if not sys.platform.startswith("linux"):
        return False
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    return trim is not None and bool(trim(0))
