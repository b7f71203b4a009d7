"""Constants are fitted to a vehicle: what is known is found, what was held out stays unseen, and decides."""

import math
from dataclasses import asdict, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.errors import ConfigurationError
from tests.training.gripping_drives import SPEED_MPS, gripping_recording
from training.observer_tuning import (
    RANGE_FACTOR,
    ConstantRange,
    best_parameters,
    judgement,
    tunable_ranges,
    tune,
    usual_constants,
)
from training.reference_drives import ReferenceDrive, parts_of_recording
from vehicle_client.estimation.observer import XC90_PARAMETERS
from vehicle_client.estimation.vehicle_geometry import XC90

GRADIENT = "rear_slip_gradient_s2pm"
TRUE_GRADIENT = XC90_PARAMETERS.rear_slip_gradient_s2pm / 2.0


def _parts(gradient: float = TRUE_GRADIENT) -> tuple[ReferenceDrive, ReferenceDrive]:
    recording = gripping_recording(slip_gradient_s2pm=gradient)
    first, rest = parts_of_recording(recording, name="made up", vehicle=XC90, tuned_frac=0.5)
    assert rest is not None
    return first, rest


def test_a_known_constant_is_found():
    first, rest = _parts()
    tuning = tune([first], [rest], XC90_PARAMETERS, constants=[GRADIENT], evaluations_limit_count=60, seed=1)
    assert tuning.found.parameters.rear_slip_gradient_s2pm == pytest.approx(TRUE_GRADIENT, rel=0.03)
    assert tuning.held_out is not None
    before, after = tuning.held_out
    assert after.rms_rad < 0.1 * before.rms_rad
    assert tuning.improved
    assert tuning.kept == tuning.found.parameters


def test_a_car_that_is_known_already_gains_little():
    first, _ = _parts(XC90_PARAMETERS.rear_slip_gradient_s2pm)
    found = best_parameters([first], XC90_PARAMETERS, constants=[GRADIENT], evaluations_limit_count=40, seed=1)
    assert found.parameters.rear_slip_gradient_s2pm == pytest.approx(XC90_PARAMETERS.rear_slip_gradient_s2pm, rel=0.03)


def test_what_is_held_out_is_never_seen():
    first, rest = _parts()
    lying = replace(rest, sideslip_rad=-3.0 * rest.sideslip_rad)
    one, other = (
        tune([first], [held], XC90_PARAMETERS, constants=[GRADIENT], evaluations_limit_count=30, seed=1)
        for held in (rest, lying)
    )
    assert one.found == other.found


def test_what_does_not_help_elsewhere_is_not_kept():
    first, rest = _parts()
    elsewhere, _ = _parts(2.0 * XC90_PARAMETERS.rear_slip_gradient_s2pm)
    tuning = tune([first], [elsewhere], XC90_PARAMETERS, constants=[GRADIENT], evaluations_limit_count=30, seed=1)
    assert tuning.found.parameters != XC90_PARAMETERS
    assert not tuning.improved
    assert tuning.kept == XC90_PARAMETERS
    alone = tune([first], [], XC90_PARAMETERS, constants=[GRADIENT], evaluations_limit_count=30, seed=1)
    assert alone.held_out is None
    assert alone.improved
    assert judgement([rest], alone.kept).rms_rad < judgement([rest], XC90_PARAMETERS).rms_rad


def test_the_same_seed_finds_the_same():
    first, _ = _parts()
    names = [GRADIENT, "roll_crossover_hz"]
    found = [
        best_parameters([first], XC90_PARAMETERS, constants=names, evaluations_limit_count=40, seed=seed)
        for seed in (5, 5, 6)
    ]
    assert found[0] == found[1]
    assert found[0].parameters != found[2].parameters


@pytest.mark.parametrize("limit_count", [2, 17, 45])
def test_no_more_is_tried_than_allowed_and_nothing_gets_worse(limit_count):
    first, _ = _parts()
    seen: list[tuple[int, float]] = []
    found = best_parameters(
        [first],
        XC90_PARAMETERS,
        constants=usual_constants(),
        evaluations_limit_count=limit_count,
        seed=1,
        on_evaluation=lambda count, best_rad: seen.append((count, best_rad)),
    )
    assert found.evaluations_count <= limit_count
    assert [count for count, _ in seen] == list(range(1, found.evaluations_count + 1))
    errors = [error for _, error in seen]
    assert errors == sorted(errors, reverse=True)
    assert judgement([first], found.parameters).rms_rad == pytest.approx(errors[-1], rel=0.005)


def test_what_is_not_named_stays():
    first, _ = _parts()
    start = replace(XC90_PARAMETERS, alpha_2_ratio=7.0)
    found = best_parameters([first], start, constants=[GRADIENT], evaluations_limit_count=20, seed=1)
    changed = {name for name, value in asdict(found.parameters).items() if value != getattr(start, name)}
    assert changed <= {GRADIENT}


def test_a_constant_that_changes_nothing_keeps_its_value():
    # The made-up car has a roll gyro, so nothing asks how far it leans.
    first, _ = _parts()
    names = [GRADIENT, "roll_gradient_s2pm"]
    found = best_parameters([first], XC90_PARAMETERS, constants=names, evaluations_limit_count=60, seed=1)
    assert found.parameters.roll_gradient_s2pm == pytest.approx(XC90_PARAMETERS.roll_gradient_s2pm, rel=1e-12)
    assert found.parameters.rear_slip_gradient_s2pm == pytest.approx(TRUE_GRADIENT, rel=0.05)


def test_a_share_may_become_zero():
    # A car that slips as much as it rolls has no sideslip: the pull to the gripping car of another one only errs.
    first, _ = _parts(XC90.rear_axle_m / SPEED_MPS**2)
    start = replace(XC90_PARAMETERS, rear_slip_gradient_s2pm=0.001)
    found = best_parameters([first], start, constants=["grip_pull_ratio"], evaluations_limit_count=40, seed=1)
    assert found.parameters.grip_pull_ratio < 0.1
    assert found.at_bounds == ()


def test_a_constant_that_wants_beyond_its_range_is_named():
    first, _ = _parts(XC90_PARAMETERS.rear_slip_gradient_s2pm / (4.0 * RANGE_FACTOR))
    found = best_parameters([first], XC90_PARAMETERS, constants=[GRADIENT], evaluations_limit_count=60, seed=1)
    assert found.at_bounds == (GRADIENT,)


@pytest.mark.parametrize("names", [["lowpass"], ["bogus"], []])
def test_what_cannot_be_tuned_is_named_beside_what_can(names):
    first, _ = _parts()
    with pytest.raises(ConfigurationError, match=r"cannot tune .*alpha_0_1ps"):
        best_parameters([first], XC90_PARAMETERS, constants=names, evaluations_limit_count=5, seed=1)


def test_a_judgement_weighs_every_judged_sample_alike():
    first, rest = _parts()
    whole, one, other = (judgement(drives, XC90_PARAMETERS) for drives in ([first, rest], [first], [rest]))
    assert whole.judged_s == pytest.approx(one.judged_s + other.judged_s)
    square = (one.rms_rad**2 * one.judged_s + other.rms_rad**2 * other.judged_s) / whole.judged_s
    assert whole.rms_rad == pytest.approx(math.sqrt(square))


def test_a_range_is_wide_enough_for_the_start():
    start = replace(XC90_PARAMETERS, alpha_2_ratio=1000.0, roll_crossover_hz=1e-4)
    ranges = tunable_ranges(start)
    for name, within in ranges.items():
        assert within.low <= getattr(start, name) <= within.high
        if not within.logarithmic:
            assert within.low == 0.0
            continue
        usual = getattr(XC90_PARAMETERS, name)
        assert within.low <= usual / RANGE_FACTOR * (1.0 + 1e-12)
        assert within.high >= usual * RANGE_FACTOR * (1.0 - 1e-12)
    assert "lowpass" not in ranges


@given(
    low=st.floats(1e-3, 10.0),
    factor=st.floats(1.5, 400.0),
    share=st.floats(0.0, 1.0),
    logarithmic=st.booleans(),
)
def test_a_share_of_a_range_is_a_value_within_and_back(low, factor, share, logarithmic):
    within = ConstantRange(low, low * factor, logarithmic=logarithmic)
    value = within.value(share)
    assert low * (1.0 - 1e-9) <= value <= low * factor * (1.0 + 1e-9)
    assert within.share(value) == pytest.approx(share, abs=1e-6)
