"""Bits to numbers, judged by somebody else's decoder."""

import math

import numpy as np
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import given
from hypothesis import strategies as st

from vehicle_client.recording.bit_fields import BitField


@st.composite
def fields(draw):
    """A field that fits into eight bytes."""
    floating = draw(st.booleans())
    length = draw(st.sampled_from([16, 32, 64])) if floating else draw(st.integers(1, 64))
    little = draw(st.booleans())
    first = draw(st.integers(0, 64 - length))
    return BitField(
        start_bit=first if little else 8 * (first // 8) + 7 - first % 8,
        length_bits=length,
        little_endian=little,
        signed=not floating and draw(st.booleans()),
        floating=floating,
        scale=draw(st.sampled_from([1.0, 0.01, -0.5])),
        zero_value=draw(st.sampled_from([0.0, -40.0])),
    )


def by_cantools(field: BitField, data: bytes) -> float:
    signal = Signal(
        "x",
        start=field.start_bit,
        length=field.length_bits,
        byte_order="little_endian" if field.little_endian else "big_endian",
        is_signed=field.signed,
        conversion=BaseConversion.factory(scale=field.scale, offset=field.zero_value, is_float=field.floating),
    )
    decoded = Message(frame_id=1, name="m", length=8, signals=[signal]).decode(data)
    assert isinstance(decoded, dict)
    return float(decoded["x"])


def alike(a: float, b: float) -> bool:
    return (math.isnan(a) and math.isnan(b)) or a == b or math.isclose(a, b, rel_tol=1e-12)


@given(fields(), st.binary(min_size=8, max_size=8))
def test_a_number_is_the_one_that_cantools_reads(field, data):
    assert alike(field.value_of_raw(field.raw(data)), by_cantools(field, data))


@given(fields(), st.lists(st.binary(min_size=8, max_size=8), min_size=1, max_size=5))
def test_many_frames_at_once_give_what_each_gives_alone(field, frames):
    raws = field.raws(np.array([list(data) for data in frames], dtype=np.uint8))
    assert raws.tolist() == [field.raw(data) for data in frames]
    values = field.values_of_raws(raws)
    assert all(alike(value, field.value_of_raw(int(raw))) for value, raw in zip(values, raws, strict=True))


@given(fields(), st.data())
def test_what_is_written_is_read_back_and_nothing_else_is_touched(field, data):
    raw = data.draw(st.integers(0, field.all_bits_set))
    payloads = np.zeros((1, 8), dtype=np.uint8)
    field.put_raws(payloads, np.array([raw], dtype=np.uint64))
    assert field.raw(payloads[0].tobytes()) == raw
    assert sum(int(byte).bit_count() for byte in payloads[0]) == raw.bit_count()


@given(st.floats(-1e6, 1e6))
def test_a_value_is_kept_to_half_a_step_or_clipped(value):
    field = BitField(4, 13, signed=True, scale=0.25, zero_value=10.0)
    kept = field.value_of_raw(field.raw_of_value(value))
    low, high = 10.0 - 4096 * 0.25, 10.0 + 4095 * 0.25
    assert abs(kept - min(max(value, low), high)) <= 0.125
    assert field.raws_of_values(np.array([value]))[0] == field.raw_of_value(value)


def test_a_frame_that_is_too_short_holds_no_number():
    assert BitField(8, 16).raw(b"\x01\x02") is None
    assert BitField(8, 16).raw(b"\x01\x02\x03") == 0x0302
