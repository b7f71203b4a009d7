"""Memory that is not needed again, handed back; memory that stays, not looked through again and again."""

from __future__ import annotations

import ctypes
import gc
import sys

GARBAGE_LOOK_COUNT = 20_000
"""New objects after which cyclic garbage is looked for among them: some hundred requests or a thousand passages."""


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


def spare_what_stays() -> None:
    """Let the search for cyclic garbage pass over all that is there now; what is freed by itself still is.

    Belongs behind a start. Looking through all its modules and records, none of which ever goes, stops the unit for
    a tenth of a second each time, and passages wait.
    """
    gc.freeze()
    # What a passage leaves behind stays for an hour, and none of it is cyclic.
    gc.set_threshold(GARBAGE_LOOK_COUNT, 20, 20)
