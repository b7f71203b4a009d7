"""Frames to channels: what a car does not know, what is not in this frame, and flags."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_client.recording.bit_fields import BitField
from vehicle_client.recording.frames import (
    FrameLayout,
    FrameSignal,
    frames_of_values,
    values_of_frame,
    values_of_frames,
)
from vehicle_client.recording.signal_mapping import SignalSource

SPEED = SignalSource("wheel_rear_left", "wheel_rear_left_mps", "M", "Speed", gain=1.0 / 3.6)
STEER = SignalSource("steer", "steer_rad", "M", "Steer", steering_table_rad=((-8.0, -0.5), (0.0, 0.0), (8.0, 0.4)))
FLAG = SignalSource("esc", "esc_active", "M", "Esc")
LAYOUT = FrameLayout(
    "M",
    0x100,
    extended=False,
    bytes_count=6,
    signals=(
        FrameSignal(SPEED, BitField(0, 16, scale=0.01), invalid_raws=frozenset({0xFFFF})),
        FrameSignal(STEER, BitField(16, 16, signed=True, scale=0.001), valid=((BitField(40, 1), frozenset({1})),)),
        FrameSignal(FLAG, BitField(32, 2), active_raws=frozenset({1}), invalid_raws=frozenset({3})),
    ),
)


def channels(data: bytes) -> dict[str, float]:
    return {source.channel: value for source, value in values_of_frame(LAYOUT, data)}


def test_numbers_come_in_our_units():
    came = channels(bytes.fromhex("1027 a00f 01 01"))
    assert came["wheel_rear_left_mps"] == pytest.approx(100.0 / 3.6)
    assert came["steer_rad"] == pytest.approx(0.2)
    assert came["esc_active"] == 1.0


def test_what_a_car_does_not_know_is_no_number():
    came = channels(bytes.fromhex("ffff a00f 03 00"))
    assert all(math.isnan(came[name]) for name in ("wheel_rear_left_mps", "steer_rad", "esc_active"))


def test_a_short_frame_holds_what_it_holds():
    assert set(channels(bytes.fromhex("1027 a0"))) == {"wheel_rear_left_mps"}


def test_a_multiplexed_signal_is_there_when_its_selector_says_so():
    layout = FrameLayout(
        "M",
        1,
        extended=False,
        bytes_count=3,
        signals=(FrameSignal(SPEED, BitField(8, 16), present=((BitField(0, 8), frozenset({2})),)),),
    )
    assert list(values_of_frame(layout, b"\x01\x24\x00")) == []
    assert [value for _, value in values_of_frame(layout, b"\x02\x24\x00")] == pytest.approx([10.0])
    ((_, time_s, values),) = values_of_frames(
        layout, np.array([0.0, 1.0]), np.array([[1, 0x24, 0], [2, 0x24, 0]], dtype=np.uint8)
    )
    assert (time_s.tolist(), values.tolist()) == ([1.0], pytest.approx([10.0]))


SIGNED = FrameLayout(
    "M",
    1,
    extended=False,
    bytes_count=3,
    signals=(
        FrameSignal(
            SignalSource("steer", "steer_rad", "M", "Steer", gain=0.5, zero_value=1.0),
            BitField(0, 16, scale=0.1),
            negative=((BitField(16, 1), frozenset({1})),),
            invalid_raws=frozenset({0xFFFF}),
        ),
    ),
)


def test_a_sign_that_is_a_signal_of_its_own_comes_before_gain_and_offset():
    frames = [b"\x64\x00\x00", b"\x64\x00\x01", b"\xff\xff\x01"]
    alone = [value for data in frames for _, value in values_of_frame(SIGNED, data)]
    assert alone == pytest.approx([6.0, -4.0, math.nan], nan_ok=True)
    payloads = np.array([list(data) for data in frames], dtype=np.uint8)
    ((_, _, together),) = values_of_frames(SIGNED, np.arange(3.0), payloads)
    assert together == pytest.approx(alone, nan_ok=True)
    assert frames_of_values(SIGNED, {"steer_rad": together}).tolist()[:2] == payloads.tolist()[:2]


def test_a_frame_that_is_cut_off_before_the_sign_says_nothing():
    assert list(values_of_frame(SIGNED, b"\x64\x00")) == []


@given(st.lists(st.binary(min_size=6, max_size=6), min_size=1, max_size=6))
def test_many_frames_say_what_each_says_alone(frames):
    payloads = np.array([list(data) for data in frames], dtype=np.uint8)
    together = {
        s.channel: values for s, _, values in values_of_frames(LAYOUT, np.arange(len(frames), dtype=float), payloads)
    }
    for i, data in enumerate(frames):
        alone = channels(data)
        assert {name: values[i] for name, values in together.items()} == pytest.approx(alone, nan_ok=True)


def test_frames_say_the_values_they_were_made_of():
    values = {
        "wheel_rear_left_mps": np.array([20.0, np.nan]),
        "steer_rad": np.array([0.1, -0.3]),
        "esc_active": np.array([0.0, np.nan]),
    }
    payloads = frames_of_values(LAYOUT, values)
    payloads[:, 5] = 1  # the validity bit, which is nobody's value
    back = {s.channel: of for s, _, of in values_of_frames(LAYOUT, np.array([0.0, 1.0]), payloads)}
    for name, of in values.items():
        assert back[name] == pytest.approx(of, abs=0.002, nan_ok=True)
