"""Faults of sensors in simulated drives: what they change, and what the onboard client makes of them."""

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest

from roadgrip.errors import TraceError
from roadgrip.sections import read_section
from tests.replay.faults import BY_DEAD_RECKONING, WITH_POSITIONS, ends_as, result_of
from vehicle_client.estimation.trace import GnssTrack, Trace, check_trace
from vehicle_client.pipeline import summarise_passage
from vehicle_client.simulator.faults import CLOCK_FAULTS, GNSS_FAULTS, Fault, with_fault
from vehicle_client.simulator.run import Drive, draw_plan, simulate_passage

GRIP_TO_SPARE_MU = 0.8
THROUGHOUT = {
    Fault.GYRO_DEAD,
    Fault.GYRO_REVERSED,
    Fault.ACCEL_DEAD,
    Fault.WHEEL_SLOW,
    Fault.ALL_WHEELS_SLOW,
    Fault.GNSS_BIAS,
    Fault.GNSS_SPARSE,
    Fault.GNSS_LATE,
}
"""From the first sample on."""


def waves(n=1000, *, gnss=True) -> Trace:
    time = 0.01 * np.arange(n)
    fixes = time[::10]
    return Trace(
        time_s=time,
        accel_x_mps2=np.sin(time),
        accel_y_mps2=np.cos(time),
        roll_rate_radps=0.1 * np.sin(time),
        yaw_rate_radps=0.2 * np.cos(time),
        steer_rad=0.1 * np.sin(time),
        wheel_speed_mps=15.0 + np.sin(time[:, None] + np.arange(4)),
        valid=np.ones(n, dtype=np.bool_),
        stability_active=np.zeros(n, dtype=np.bool_),
        gnss=GnssTrack(fixes, 60.0 + 1e-4 * fixes, 10.0 + 0.0 * fixes, 1.5 + 0.0 * fixes, 15.0 + 0.0 * fixes)
        if gnss
        else None,
    )


def arrays(trace: Trace):
    """Return all numbers of a trace by name."""
    names = [f.name for f in fields(Trace) if f.name not in {"gnss", "quality", "absent"}]
    found = {name: getattr(trace, name) for name in names}
    if trace.gnss is not None:
        found |= {f"gnss.{f.name}": getattr(trace.gnss, f.name) for f in fields(GnssTrack)}
    return found


@pytest.mark.parametrize("fault", Fault)
def test_a_fault_changes_something_and_leaves_the_trace_it_was_given_alone(fault):
    trace, untouched = waves(), waves()
    broken = arrays(with_fault(trace, fault, at_s=5.0))
    for name, values in arrays(untouched).items():
        assert np.array_equal(values, arrays(trace)[name]), name
    assert any(not np.array_equal(values, broken[name]) for name, values in arrays(trace).items())


@pytest.mark.parametrize("fault", sorted(set(Fault) - THROUGHOUT))
def test_before_its_moment_a_fault_is_not_there(fault):
    before, broken = arrays(waves()), arrays(with_fault(waves(), fault, at_s=5.0))
    for name, values in before.items():
        count = 50 if name.startswith("gnss") else 500
        assert np.array_equal(values[:count], broken[name][:count]), name


@pytest.mark.parametrize("fault", Fault)
def test_only_faults_of_the_clock_break_the_grid_of_samples(fault):
    trace = with_fault(waves(), fault, at_s=5.0)
    if fault in CLOCK_FAULTS:
        with pytest.raises(TraceError):
            check_trace(trace)
    else:
        check_trace(trace)


@pytest.mark.parametrize("fault", sorted(GNSS_FAULTS))
def test_without_positions_nothing_happens_to_them(fault):
    trace = waves(gnss=False)
    assert with_fault(trace, fault, at_s=5.0) is trace


def test_a_trace_that_does_not_report_interventions_stays_one():
    trace = replace(waves(), stability_active=None)
    for fault in Fault:
        assert with_fault(trace, fault, at_s=5.0).stability_active is None


@pytest.mark.parametrize("at_s", [-1.0, 0.0, 10.0, 1e6])
def test_a_fault_outside_the_trace_is_an_error(at_s):
    with pytest.raises(TraceError):
        with_fault(waves(), Fault.GYRO_SPIKE, at_s=at_s)


@cache
def drive(*, with_gnss: bool) -> Drive:
    section = read_section("s-turn")
    plan = draw_plan(np.random.default_rng(3), section=section, base_friction_mu=GRIP_TO_SPARE_MU, with_gnss=with_gnss)
    done = simulate_passage(section, replace(plan, wear_factor=1.0, target_speed_mps=16.0))
    assert done.completed
    return done


@pytest.mark.sim
@pytest.mark.parametrize("with_gnss", [False, True], ids=["dead_reckoning", "positions"])
@pytest.mark.parametrize("fault", Fault)
def test_a_simulated_drive_with_a_fault_ends_as_the_page_says(fault, with_gnss):
    done, section = drive(with_gnss=with_gnss), read_section("s-turn")
    at_s = float(np.interp(0.4 * section.length_m, done.truth.station_m, done.truth.time_s))
    expected = (WITH_POSITIONS if with_gnss else BY_DEAD_RECKONING)[fault]
    result = result_of(done.trace, section, fault, at_s=at_s)
    assert ends_as(result, expected), result


@pytest.mark.sim
@pytest.mark.parametrize("fault", sorted(CLOCK_FAULTS))
def test_a_trace_off_the_grid_is_an_error_to_the_onboard_client(fault):
    with pytest.raises(TraceError):
        summarise_passage(with_fault(drive(with_gnss=False).trace, fault, at_s=5.0), read_section("s-turn"))


def test_the_page_tells_every_fault(project_root):
    page = (project_root / "docs" / "sensors.md").read_text(encoding="utf-8")
    for fault in Fault:
        assert f"`{fault.value}`" in page, fault
