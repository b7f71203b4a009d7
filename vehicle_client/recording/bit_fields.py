"""Signals inside the bytes of CAN frames: bits to numbers and back, one frame or many at once."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from roadgrip.units import FloatArray

RawArray: TypeAlias = NDArray[np.uint64]
PayloadArray: TypeAlias = NDArray[np.uint8]
"""One frame a row, one byte a column."""

_FLOATS = {16: ("<e", np.float16), 32: ("<f", np.float32), 64: ("<d", np.float64)}
_UNSIGNED = {16: np.uint16, 32: np.uint32, 64: np.uint64}


@dataclass(frozen=True, slots=True)
class BitField:
    """Where in a frame a number is, and what it means.

    Attributes:
        start_bit: As a DBC counts, bit 0 being the lowest of the first byte: of the number's lowest bit if its lowest
            byte comes first, else of its highest bit.
        length_bits: 1 to 64.
        little_endian: Whether the lowest byte comes first (Intel), or the highest (Motorola).
        signed: Two's complement.
        floating: IEEE 754, of 16, 32 or 64 bits.
        scale: Value of one step of the raw number.
        zero_value: Value where the raw number is zero.
    """

    start_bit: int
    length_bits: int
    little_endian: bool = True
    signed: bool = False
    floating: bool = False
    scale: float = 1.0
    zero_value: float = 0.0

    @property
    def all_bits_set(self) -> int:
        """The raw number with every bit set, which many a car sends when it does not know."""
        return (1 << self.length_bits) - 1

    @property
    def bytes_count(self) -> int:
        """Bytes that a frame must have to hold the number."""
        return self._last_byte + 1

    @property
    def _first_bit(self) -> int:
        """The first bit in the order of sending, the highest of each byte first; of little endian its lowest bit."""
        start = self.start_bit
        return start if self.little_endian else 8 * (start // 8) + 7 - start % 8

    @property
    def _last_byte(self) -> int:
        return (self._first_bit + self.length_bits - 1) // 8

    @property
    def _shift_bits(self) -> int:
        """Bits below the number in the lowest of its bytes."""
        if self.little_endian:
            return self.start_bit % 8
        return 7 - (self._first_bit + self.length_bits - 1) % 8

    @property
    def _bytes_upwards(self) -> range:
        """The number's bytes, the lowest first."""
        first, last = self._first_bit // 8, self._last_byte
        return range(first, last + 1) if self.little_endian else range(last, first - 1, -1)

    def raw(self, data: bytes) -> int | None:
        """Return the bits of one frame as a number without sign; None if the frame is too short for it."""
        if len(data) < self.bytes_count:
            return None
        low = self._first_bit // 8
        part = data[low : self._last_byte + 1]
        whole = int.from_bytes(part, "little" if self.little_endian else "big")
        return whole >> self._shift_bits & self.all_bits_set

    def value_of_raw(self, raw: int) -> float:
        """Return what a raw number means."""
        number: float = raw
        if self.floating:
            layout = _FLOATS[self.length_bits][0]
            (number,) = struct.unpack(layout, raw.to_bytes(self.length_bits // 8, "little"))
        elif self.signed and raw >> (self.length_bits - 1):
            number = raw - (1 << self.length_bits)
        return number * self.scale + self.zero_value

    def raw_of_value(self, value: float) -> int:
        """Return the raw number nearest to a value, which the field can hold at best (it is clipped)."""
        number = (value - self.zero_value) / self.scale
        if self.floating:
            return int.from_bytes(struct.pack(_FLOATS[self.length_bits][0], number), "little")
        low = -(1 << (self.length_bits - 1)) if self.signed else 0
        high = low + self.all_bits_set
        return min(max(round(number), low), high) & self.all_bits_set

    def raws(self, payloads: PayloadArray) -> RawArray:
        """Return the bits of many frames, all long enough, as numbers without sign. (n,)

        Args:
            payloads: One frame a row. (n, bytes)
        """
        whole = np.zeros(len(payloads), dtype=np.uint64)
        for i, place in enumerate(self._bytes_upwards):
            shift = 8 * i - self._shift_bits
            byte = payloads[:, place].astype(np.uint64)
            whole |= byte << np.uint64(shift) if shift >= 0 else byte >> np.uint64(-shift)
        return whole & np.uint64(self.all_bits_set)

    def values_of_raws(self, raws: RawArray) -> FloatArray:
        """Return what raw numbers mean. (n,)"""
        # A message may hold a NaN that complains when it is used or widened; it says "unknown" like any other.
        with np.errstate(invalid="ignore"):
            if self.floating:
                bits, kind = _UNSIGNED[self.length_bits], _FLOATS[self.length_bits][1]
                numbers = raws.astype(bits).view(kind).astype(np.float64)
            elif self.signed:
                up = np.uint64(64 - self.length_bits)
                numbers = ((raws << up).view(np.int64) >> up.astype(np.int64)).astype(np.float64)
            else:
                numbers = raws.astype(np.float64)
            return numbers * self.scale + self.zero_value

    def put_raws(self, payloads: PayloadArray, raws: RawArray) -> None:
        """Write raw numbers into many frames, whose bits there are zero.

        Args:
            payloads: One frame a row; changed. (n, bytes)
            raws: (n,)
        """
        for i, place in enumerate(self._bytes_upwards):
            shift = 8 * i - self._shift_bits
            part = raws >> np.uint64(shift) if shift >= 0 else raws << np.uint64(-shift)
            payloads[:, place] |= (part & np.uint64(0xFF)).astype(np.uint8)

    def raws_of_values(self, values: FloatArray) -> RawArray:
        """Return the raw numbers nearest to values that are there, clipped to what whole numbers can hold. (n,)"""
        numbers = (values - self.zero_value) / self.scale
        if self.floating:
            bits, kind = _UNSIGNED[self.length_bits], _FLOATS[self.length_bits][1]
            return numbers.astype(kind).view(bits).astype(np.uint64)
        low = -float(1 << (self.length_bits - 1)) if self.signed else 0.0
        whole = np.clip(np.rint(numbers), low, low + float(self.all_bits_set))
        raws = whole.astype(np.int64).view(np.uint64) if self.signed else whole.astype(np.uint64)
        return raws & np.uint64(self.all_bits_set)
