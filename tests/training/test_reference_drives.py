"""Drives with a known sideslip, from files and from the simulator."""

import gzip
from dataclasses import replace

import numpy as np
import pytest

from roadgrip.errors import TraceError
from roadgrip.sections import read_section
from tests.training.gripping_drives import gripping_recording, reference_csv
from training.reference_drives import (
    EDGE_S,
    MAPPINGS,
    ReferenceFormat,
    parts_of_recording,
    recording_with_reference,
    simulated_drives,
)
from training.scenarios import Terms
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.simulator.plan import SensorGrade

MADE_UP = gripping_recording(slip_gradient_s2pm=0.005)


@pytest.mark.parametrize("packed", [False, True])
def test_our_own_format_carries_a_reference(packed):
    data = reference_csv(MADE_UP)
    read = recording_with_reference(
        gzip.compress(data) if packed else data, ReferenceFormat.ROADGRIP, place="drive.csv"
    )
    assert np.array_equal(read.trace.accel_y_mps2, MADE_UP.trace.accel_y_mps2)
    for name, values in MADE_UP.reference.items():
        assert np.allclose(read.reference[name], values, rtol=0.0, atol=1e-12)


def test_a_silent_reference_is_not_judged():
    silent = MADE_UP.reference["velocity_y_mps"].copy()
    silent[1000:1200] = np.nan
    read = recording_with_reference(
        reference_csv(MADE_UP, reference_velocity_y_mps=silent), ReferenceFormat.ROADGRIP, place="drive.csv"
    )
    drive, rest = parts_of_recording(read, name="drive", vehicle=XC90, tuned_frac=1.0)
    assert rest is None
    assert not drive.judged[1000:1200].any()
    assert drive.judged[900:999].all()
    assert drive.judged[1201:1300].all()
    assert np.isfinite(drive.sideslip_rad).all()


def test_parts_follow_each_other_and_share_no_sample():
    first, rest = parts_of_recording(MADE_UP, name="drive", vehicle=XC90, tuned_frac=0.4)
    assert rest is not None
    both = np.concatenate([first.trace.time_s, rest.trace.time_s])
    assert np.array_equal(both, MADE_UP.trace.time_s)
    truth = np.arctan2(MADE_UP.reference["velocity_y_mps"], MADE_UP.reference["velocity_x_mps"])
    assert np.allclose(np.concatenate([first.sideslip_rad, rest.sideslip_rad]), truth)
    for part in (first, rest):
        edge = round(EDGE_S * 100.0)
        assert not part.judged[:edge].any()
        assert not part.judged[-edge:].any()
        assert part.judged[edge:-edge].all()


def test_standing_still_is_not_judged():
    slow = replace(MADE_UP, reference=dict(MADE_UP.reference) | {"velocity_x_mps": np.full(6000, 3.0)})
    with pytest.raises(TraceError, match="never faster than 5 m/s"):
        parts_of_recording(slow, name="drive", vehicle=XC90, tuned_frac=0.5)


def test_a_part_must_be_long_enough_to_judge():
    with pytest.raises(TraceError, match="too short to judge"):
        parts_of_recording(MADE_UP, name="drive", vehicle=XC90, tuned_frac=0.9)


def test_a_recording_without_reference_is_refused():
    names = [f"reference_{name}" for name in MADE_UP.reference]
    header, _, body = reference_csv(MADE_UP).partition(b"\n")
    renamed = header.replace(b"reference_velocity", b"velocity")
    with pytest.raises(TraceError, match=", ".join(names)):
        recording_with_reference(renamed + b"\n" + body, ReferenceFormat.ROADGRIP, place="drive.csv")


def test_a_recording_without_lateral_accelerometer_is_refused():
    mapping = MAPPINGS[ReferenceFormat.IAC_AV21]
    columns = [mapping.time_column, *(c.column for c in (*mapping.channels.values(), *mapping.reference.values()))]
    rows = "\n".join(",".join(f"{k / 100.0}" for _ in columns) for k in range(200))
    data = f"{','.join(columns)}\n{rows}\n".encode()
    with pytest.raises(TraceError, match="no lateral accelerometer"):
        recording_with_reference(data, ReferenceFormat.IAC_AV21, place="indy.csv")


@pytest.mark.sim
def test_simulated_drives_come_with_their_truth():
    terms = Terms("test", 4, SensorGrade.IDEAL)
    section = read_section("s-turn")
    drives = simulated_drives(section, terms, base_friction_mu=0.8, drives_count=2, vehicle=XC90)
    assert len(drives) == 2
    for drive in drives:
        assert drive.section == section
        assert drive.judged.any()
        assert 0.0 < np.abs(drive.sideslip_rad[drive.judged]).max() < 0.5
    again = simulated_drives(section, terms, base_friction_mu=0.8, drives_count=1, vehicle=XC90)
    assert np.array_equal(again[0].trace.accel_y_mps2, drives[0].trace.accel_y_mps2)


@pytest.mark.sim
def test_a_road_that_cannot_be_driven_gives_fewer_drives():
    terms = Terms("test", 4, SensorGrade.IDEAL)
    drives = simulated_drives(read_section("s-turn"), terms, base_friction_mu=0.05, drives_count=1, vehicle=XC90)
    assert drives == []
