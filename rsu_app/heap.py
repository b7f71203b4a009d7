"""Memory that was freed, handed back to the machine."""

from __future__ import annotations

import ctypes
import sys


def give_back_freed_memory() -> None:
    """Hand what was freed and is kept for later back to the machine; nothing where the C library cannot.

    Reading a bundle and restoring a window take memory that is not needed again, and glibc keeps what lies below the
    last block in use: 18 MB of 160 after the packaged bundle was loaded. Takes some milliseconds, so it belongs behind
    work that is done once, not into what every passage passes.
    """
    if not sys.platform.startswith("linux"):
        return
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
