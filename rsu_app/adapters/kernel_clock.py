"""What the kernel knows about its wall clock: whether anything keeps it right, and how wrong it may be."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

_UNSYNCHRONISED = 5
"""What adjtimex answers while nothing keeps the clock right."""


class _Timex(ctypes.Structure):
    """`struct timex` of Linux, as far as it is read here; the rest is room for the kernel to write to."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("rest", ctypes.c_char * 256),
    )


@dataclass(frozen=True, slots=True)
class KernelClock:
    """The kernel's opinion of the wall clock.

    Attributes:
        synchronised: Whether something (NTP, PTP, GNSS) keeps it right at present.
        max_error_s: How wrong it may be at most, if so.
    """

    synchronised: bool
    max_error_s: float


def kernel_clock() -> KernelClock | None:
    """Return the kernel's opinion of the wall clock, None where it cannot be asked. Changes nothing."""
    try:
        state = _Timex()
        answer = ctypes.CDLL(None).adjtimex(ctypes.byref(state))
    except (OSError, AttributeError):
        return None
    if answer < 0:
        return None
    return KernelClock(synchronised=answer != _UNSYNCHRONISED, max_error_s=state.maxerror / 1e6)
