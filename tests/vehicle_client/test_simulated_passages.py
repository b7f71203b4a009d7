"""The pipeline on simulated drives, judged by their truth."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import roadgrip
from roadgrip.records import Reason, Rejected
from roadgrip.section_file import section_from_json
from roadgrip.units import SAMPLE_S
from vehicle_client.estimation.trace import mirrored
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.mapmatch.match import MatchMethod
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.simulator.run import Drive, SensorGrade, draw_plan, simulate_passage

pytestmark = pytest.mark.sim

ROADS = ("long-turn", "s-turn", "sharp-turn")
FRICTIONS = (0.25, 0.4, 0.7)


@cache
def section_named(name):
    folder = Path(roadgrip.__file__).parent / "sections"
    return section_from_json((folder / f"{name}.json").read_text(encoding="utf-8"))


@cache
def drives(name, grade, *, with_gnss=False) -> tuple[Drive, ...]:
    rng = np.random.default_rng(11)
    plans = [
        draw_plan(rng, section=section_named(name), base_friction_mu=mu, grade=grade, with_gnss=with_gnss)
        for mu in FRICTIONS
    ]
    done = [simulate_passage(section_named(name), plan) for plan in plans]
    return tuple(drive for drive in done if drive.completed)


def made(outcome) -> Summarised:
    assert isinstance(outcome, Summarised), outcome
    return outcome


def position_error_m(drive: Drive, result: Summarised, section) -> float:
    ends = [result.match.entry_s, result.match.exit_s]
    at = np.interp(ends, drive.truth.time_s, drive.truth.station_m)
    return float(np.abs(at - np.array([0.0, section.length_m])).max())


@pytest.mark.parametrize("grade", SensorGrade)
@pytest.mark.parametrize("name", ROADS)
def test_every_completed_drive_is_summarised_where_it_took_place(name, grade):
    section = section_named(name)
    assert drives(name, grade)
    for drive in drives(name, grade):
        result = made(summarise_passage(drive.trace, section))
        assert position_error_m(drive, result, section) < 10.0


@pytest.mark.parametrize("name", ROADS)
def test_satellites_place_a_drive_as_well(name):
    section = section_named(name)
    if len(section.anchors) < 2:
        pytest.skip("the road has no anchors")
    for drive in drives(name, SensorGrade.AUTOMOTIVE, with_gnss=True):
        result = made(summarise_passage(drive.trace, section))
        assert result.match.method is MatchMethod.GNSS
        assert position_error_m(drive, result, section) < 10.0


@pytest.mark.parametrize("name", ROADS)
def test_other_roads_and_mirrored_ones_are_refused(name):
    for drive in drives(name, SensorGrade.AUTOMOTIVE):
        for other in ROADS:
            outcomes = [summarise_passage(mirrored(drive.trace), section_named(other))]
            if other != name:
                outcomes.append(summarise_passage(drive.trace, section_named(other)))
            for outcome in outcomes:
                assert isinstance(outcome, Rejected), outcome
                assert outcome.reason in {Reason.WRONG_ROAD, Reason.PASSAGE_ABORTED}


@pytest.mark.parametrize("name", ROADS)
def test_speed_is_known_to_two_per_cent(name):
    for drive in drives(name, SensorGrade.AUTOMOTIVE):
        result = made(summarise_passage(drive.trace, section_named(name)))
        inside = result.match.inside(drive.trace.time_s)
        error = (result.signals.speed_mps / drive.truth.velocity_x_mps)[inside] - 1.0
        assert np.sqrt(np.mean(error**2)) < 0.02


@pytest.mark.parametrize("grade", SensorGrade)
@pytest.mark.parametrize("name", ROADS)
def test_the_sideslip_is_seen_to_less_than_half_of_it(name, grade):
    error, truth, product, estimate = 0.0, 0.0, 0.0, 0.0
    for drive in drives(name, grade):
        result = made(summarise_passage(drive.trace, section_named(name)))
        inside = result.match.inside(drive.trace.time_s)
        found, true = result.signals.sideslip_rad[inside], drive.truth.sideslip_rad[inside]
        error += float(np.sum((found - true) ** 2))
        truth += float(true @ true)
        product += float(found @ true)
        estimate += float(found @ found)
    assert product / np.sqrt(truth * estimate) > 0.9
    assert np.sqrt(error / truth) < 0.5


@pytest.mark.parametrize(("x_m", "y_m", "turned_rad"), [(1.5, -0.4, 0.1), (-0.6, 0.3, -0.05)])
def test_a_sensor_elsewhere_in_a_simulated_car_sees_the_same_drive(x_m, y_m, turned_rad):
    # What an exact unit there would have read, from what one at the centre of gravity did.
    section, drive = section_named("s-turn"), drives("s-turn", SensorGrade.IDEAL)[0]
    trace = drive.trace
    w = trace.yaw_rate_radps
    dw = np.gradient(w, SAMPLE_S)
    ax = trace.accel_x_mps2 - dw * y_m - w**2 * x_m
    ay = trace.accel_y_mps2 + dw * x_m - w**2 * y_m
    c, s = np.cos(turned_rad), np.sin(turned_rad)
    elsewhere = replace(
        trace, accel_x_mps2=c * ax + s * ay, accel_y_mps2=c * ay - s * ax, roll_rate_radps=c * trace.roll_rate_radps
    )
    vehicle = replace(XC90, imu_x_m=x_m, imu_y_m=y_m, imu_yaw_rad=turned_rad)
    here = made(summarise_passage(trace, section)).signals
    there = made(summarise_passage(elsewhere, section, vehicle=vehicle)).signals
    amount = float(np.sqrt(np.mean(here.sideslip_rad**2)))
    # The pitch rate, which no trace holds, is a turned unit's share of roll.
    assert np.sqrt(np.mean((there.sideslip_rad - here.sideslip_rad) ** 2)) < 0.05 * amount
    unaware = made(summarise_passage(elsewhere, section)).signals
    assert np.sqrt(np.mean((unaware.sideslip_rad - here.sideslip_rad) ** 2)) > 0.05 * amount
