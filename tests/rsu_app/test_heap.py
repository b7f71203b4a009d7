"""Freed memory goes back to the machine where the C library can give it back, and nothing breaks where it cannot."""

from __future__ import annotations

import ctypes
import gc
import sys
import weakref
from pathlib import Path

import pytest

from rsu_app.heap import give_back_freed_memory, spare_what_stays

BLOCKS_COUNT = 4_000
BLOCK_BYTES = 8_000
"""Small enough to come from the heap and not from a mapping of its own."""


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="this C library gives nothing back")
def test_what_was_freed_below_a_block_in_use_goes_back():
    libc = ctypes.CDLL(None)
    libc.malloc.restype, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
    blocks = [libc.malloc(BLOCK_BYTES) for _ in range(BLOCKS_COUNT)]
    for block in blocks:
        ctypes.memset(block, 1, BLOCK_BYTES)
    in_use = blocks.pop()
    for block in blocks:
        libc.free(block)
    before = resident_bytes()
    give_back_freed_memory()
    assert before - resident_bytes() > BLOCKS_COUNT * BLOCK_BYTES / 2
    libc.free(in_use)


def test_a_c_library_that_cannot_is_left_alone(monkeypatch):
    monkeypatch.setattr(ctypes, "CDLL", lambda _name: object())
    give_back_freed_memory()


def test_another_system_is_not_even_asked(monkeypatch):
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(ctypes, "CDLL", None)
    give_back_freed_memory()


def test_what_stays_is_not_looked_through_again_and_new_garbage_is():
    class Knot:
        def __init__(self):
            self.me = self

    stays = Knot()
    try:
        spare_what_stays()
        assert all(each is not stays for each in gc.get_objects())
        knot = Knot()
        seen = weakref.ref(knot)
        del knot
        gc.collect()
        assert seen() is None
    finally:
        gc.unfreeze()
