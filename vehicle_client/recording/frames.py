"""What the frames of one CAN message say about our channels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from roadgrip.units import BoolArray, FloatArray
    from vehicle_client.recording.bit_fields import BitField, PayloadArray, RawArray
    from vehicle_client.recording.signal_mapping import SignalSource


@dataclass(frozen=True, slots=True)
class Frames:
    """CAN frames in the order of time; all arrays (n,) unless said.

    Attributes:
        time_s: On the clock of the trace.
        frame_id: Identifier.
        extended: Whether it has 29 bits.
        length_bytes: How many bytes of the payload count.
        payloads: (n, 8)
    """

    time_s: FloatArray
    frame_id: NDArray[np.int64]
    extended: BoolArray
    length_bytes: NDArray[np.int64]
    payloads: PayloadArray


@dataclass(frozen=True, slots=True)
class FrameSignal:
    """One channel inside the frames of a message.

    Attributes:
        source: Which channel, and how its numbers become ours.
        bits: Where the number is.
        present: A multiplexed signal is there only in frames whose selectors hold one of these raw numbers.
        valid: It holds only where these fields have one of these raw numbers.
        negative: The number is below zero where these fields have one of these raw numbers.
        invalid_raws: Raw numbers that mean there is none.
        active_raws: Of a flag, raw numbers that mean yes; any but zero if None.
    """

    source: SignalSource
    bits: BitField
    present: tuple[tuple[BitField, frozenset[int]], ...] = ()
    valid: tuple[tuple[BitField, frozenset[int]], ...] = ()
    negative: tuple[tuple[BitField, frozenset[int]], ...] = ()
    invalid_raws: frozenset[int] = frozenset()
    active_raws: frozenset[int] | None = None

    @property
    def is_flag(self) -> bool:
        """Whether it says yes or no."""
        return self.source.channel.endswith("_active")


@dataclass(frozen=True, slots=True)
class FrameLayout:
    """All our channels inside the frames of one message.

    Attributes:
        message: Name in the DBC.
        frame_id: Its identifier there.
        extended: Whether that has 29 bits.
        bytes_count: Of its frames.
        signals: In the order of the mapping.
        bus: Where it is to be read from; any bus if empty.
    """

    message: str
    frame_id: int
    extended: bool
    bytes_count: int
    signals: tuple[FrameSignal, ...]
    bus: str = ""


def values_of_frame(layout: FrameLayout, data: bytes) -> Iterator[tuple[SignalSource, float]]:
    """Yield the channels of one frame in our units; NaN where the car says that it does not know.

    A multiplexed signal that is not in this frame, and one that a short frame cuts off, is left out.
    """
    for signal in layout.signals:
        raw = signal.bits.raw(data)
        unsigned = any(bits.raw(data) is None for bits, _ in signal.negative)
        if raw is None or unsigned or not all(bits.raw(data) in raws for bits, raws in signal.present):
            continue
        known = raw not in signal.invalid_raws and all(bits.raw(data) in raws for bits, raws in signal.valid)
        if not known:
            yield signal.source, math.nan
        elif signal.is_flag:
            yield signal.source, float(raw != 0 if signal.active_raws is None else raw in signal.active_raws)
        else:
            value = signal.bits.value_of_raw(raw)
            if any(bits.raw(data) in raws for bits, raws in signal.negative):
                value = -value
            if signal.source.steering_table_rad:
                value = float(signal.source.converted(np.array([value]))[0])
            else:
                value = value * signal.source.gain + signal.source.zero_value
            yield signal.source, value if math.isfinite(value) else math.nan


def values_of_frames(
    layout: FrameLayout, time_s: FloatArray, payloads: PayloadArray
) -> Iterator[tuple[SignalSource, FloatArray, FloatArray]]:
    """Yield what `values_of_frame` says of many frames of equal length: channel, times and values. Each (k,)

    Args:
        layout: The message.
        time_s: (n,)
        payloads: One frame a row. (n, bytes)
    """
    for signal in layout.signals:
        fields = [signal.bits, *(bits for bits, _ in (*signal.present, *signal.valid, *signal.negative))]
        if max(bits.bytes_count for bits in fields) > payloads.shape[1]:
            continue
        there = _all_among(signal.present, payloads)
        part, at_s = (payloads, time_s) if there.all() else (payloads[there], time_s[there])
        raws = signal.bits.raws(part)
        known = ~_among(raws, signal.invalid_raws) & _all_among(signal.valid, part)
        if signal.is_flag:
            values = (raws != 0 if signal.active_raws is None else _among(raws, signal.active_raws)).astype(np.float64)
        else:
            values = signal.bits.values_of_raws(raws)
            if signal.negative:
                values = np.where(_all_among(signal.negative, part), -values, values)
            values = signal.source.converted(values)
        yield signal.source, at_s, np.where(known & np.isfinite(values), values, np.nan)


def frames_of_values(layout: FrameLayout, values: Mapping[str, FloatArray]) -> PayloadArray:
    """Return frames that say the channels of a message; what is NaN is said to be invalid. (n, bytes)

    The other direction of `values_of_frames`, within half a step of each signal; what a signal cannot hold is clipped.

    Args:
        layout: The message; each of its signals that may be NaN must have an invalid value.
        values: By channel, of one length. Each (n,)
    """
    count = len(next(iter(values.values())))
    payloads = np.zeros((count, layout.bytes_count), dtype=np.uint8)
    for signal in layout.signals:
        ours = values[signal.source.channel]
        known = np.isfinite(ours)
        theirs = signal.source.inverted(np.where(known, ours, 0.0))
        for sign, negative_raws in signal.negative:
            minus, plus = min(negative_raws), _other_than(negative_raws)
            sign.put_raws(payloads, np.where(theirs < 0.0, minus, plus).astype(np.uint64))
            theirs = np.abs(theirs)
        raws = signal.bits.raws_of_values(theirs)
        if signal.invalid_raws:
            raws = np.where(known, raws, np.uint64(max(signal.invalid_raws)))
        signal.bits.put_raws(payloads, raws)
    return payloads


def _other_than(raws: frozenset[int]) -> int:
    return next(raw for raw in range(len(raws) + 1) if raw not in raws)


def _all_among(conditions: tuple[tuple[BitField, frozenset[int]], ...], payloads: PayloadArray) -> BoolArray:
    fulfilled = np.ones(len(payloads), dtype=bool)
    for bits, raws in conditions:
        fulfilled &= _among(bits.raws(payloads), raws)
    return fulfilled


def _among(raws: RawArray, wanted: frozenset[int]) -> BoolArray:
    return np.isin(raws, np.array(sorted(wanted), dtype=np.uint64)) if wanted else np.zeros(len(raws), dtype=bool)
