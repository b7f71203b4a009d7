"""Every refusal of the onboard client, each reached, and where its limits lie."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from roadgrip.features import statistics_of
from roadgrip.records import QualityFlag, Reason, Rejected
from roadgrip.units import GRAVITY_MPS2
from tests.vehicle_client.synthetic import drive_over, fixes_of, motion, negative, road, s_turn, surveyed, with_noise
from vehicle_client.estimation.offsets import sensor_offsets
from vehicle_client.estimation.trace import Trace, part_of
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.pipeline import Summarised, summarise_passage

SECTION = surveyed(road(s_turn))
CLEAN, STATION = drive_over(s_turn, swing_mps=1.0)
TRACE = with_noise(CLEAN, np.random.default_rng(2))
GNSS = fixes_of(SECTION, TRACE.time_s, STATION, rng=np.random.default_rng(1), noise_m=0.5)
ENTRY, EXIT = (int(np.searchsorted(STATION, at)) for at in (0.0, 400.0))
ROWS = np.arange(TRACE.samples_count)


def lost(rows) -> Trace:
    return replace(TRACE, valid=~rows)


def slowed(slowest_mps: float) -> Trace:
    """Return a drive that slows down to some speed on the straight between the bends."""
    station, travelled, speeds = -80.0, [], []
    while station < 460.0:
        speed = 10.0 - (10.0 - slowest_mps) * np.exp(-(((station - 200.0) / 15.0) ** 2))
        travelled.append(station)
        speeds.append(speed)
        station += 0.01 * speed
    speed, at = np.array(speeds), np.array(travelled)
    return with_noise(
        motion(speed, np.where((at > 0.0) & (at < 400.0), s_turn(at), 0.0) * speed), np.random.default_rng(4)
    )


def elsewhere() -> Trace:
    trace, _ = drive_over(negative(s_turn), swing_mps=1.0)
    return with_noise(trace, np.random.default_rng(3))


WAYS: dict[Reason, tuple[Callable[[], Trace], ...]] = {
    Reason.TOO_SHORT: (
        lambda: motion(np.full(99, 15.0), np.zeros(99)),
        lambda: lost(ROWS >= 99),
    ),
    Reason.TOO_MANY_GAPS: (
        lambda: lost((ROWS >= ENTRY + 500) & (ROWS < ENTRY + 531)),
        lambda: lost((ROWS % 200 < 12) & (ROWS >= ENTRY)),
        lambda: replace(TRACE, gnss=GNSS, valid=~((ROWS >= ENTRY + 500) & (ROWS < ENTRY + 531))),
        # A drive that is not found, and has too many gaps to say that it was elsewhere.
        lambda: replace(elsewhere(), valid=ROWS % 200 >= 12),
        lambda: replace(elsewhere(), valid=(ROWS < 1500) | (ROWS > 1540)),
    ),
    Reason.TOO_SLOW: (lambda: slowed(1.8),),
    Reason.WRONG_ROAD: (
        elsewhere,
        # A broken accelerometer is no reason why a drive is not found.
        lambda: replace(elsewhere(), accel_y_mps2=-elsewhere().accel_y_mps2),
    ),
    Reason.PASSAGE_ABORTED: (
        lambda: part_of(TRACE, from_s=0.0, to_s=float(TRACE.time_s[EXIT - 500])),
        lambda: motion(np.full(100, 15.0), np.zeros(100)),
        lambda: motion(np.zeros(3000), np.zeros(3000), steer_rad=np.zeros(3000)),
    ),
    Reason.SENSOR_FAULT: (
        lambda: replace(TRACE, yaw_rate_radps=-TRACE.yaw_rate_radps),
        lambda: replace(TRACE, accel_y_mps2=-TRACE.accel_y_mps2),
        lambda: replace(TRACE, steer_rad=TRACE.steer_rad + 0.05 * (ROWS > ENTRY + 800)),
    ),
}


@pytest.mark.parametrize(
    ("reason", "drive"), [pytest.param(reason, way, id=reason) for reason, ways in WAYS.items() for way in ways]
)
def test_each_refusal_is_reached_and_says_more(reason, drive):
    outcome = summarise_passage(drive(), SECTION)
    assert isinstance(outcome, Rejected), outcome
    assert outcome.reason is reason, outcome
    assert outcome.detail


def test_the_refusals_are_those_that_the_client_says_it_has():
    said = {reason for reason in Reason if f"({reason.name}" in (summarise_passage.__doc__ or "")}
    assert said == set(WAYS)


FLAGS: dict[QualityFlag, Callable[[], Trace]] = {
    QualityFlag.STABILITY_ACTIVE: lambda: replace(TRACE, gnss=GNSS, stability_active=ROWS == ENTRY + 400),
    QualityFlag.NO_GNSS: lambda: TRACE,
    QualityFlag.OFFSETS_UNCERTAIN: lambda: replace(TRACE, gnss=GNSS, valid=(ROWS >= ENTRY) | (ROWS % 100 > 30)),
    QualityFlag.SAMPLES_MISSING: lambda: replace(TRACE, gnss=GNSS, valid=ROWS != ENTRY + 400),
    QualityFlag.REFERENCE_SPEED: lambda: replace(TRACE, gnss=GNSS, quality=QualityFlag.REFERENCE_SPEED),
    QualityFlag.GNSS_POOR: lambda: replace(TRACE, gnss=GNSS.where(np.arange(len(GNSS.time_s)) % 30 == 0)),
    QualityFlag.SENSORS_DOUBTFUL: lambda: replace(TRACE, gnss=GNSS, yaw_rate_radps=1.13 * TRACE.yaw_rate_radps),
}


@pytest.mark.parametrize("flag", FLAGS, ids=lambda flag: flag.name)
def test_each_flag_is_reached_alone(flag):
    outcome = summarise_passage(FLAGS[flag](), SECTION)
    assert isinstance(outcome, Summarised), outcome
    assert outcome.summary.quality == flag


def test_no_flag_is_left_out():
    assert set(FLAGS) == set(QualityFlag)


# Limits --------------------------------------------------------------------------------------------------------------


def test_a_twentieth_may_be_missing_and_no_more():
    # Gaps of a tenth of a second, evenly spread over the section, to either side of 5 %.
    for every, fine in ((190, False), (220, True)):
        outcome = summarise_passage(lost((ROWS % every < 10) & (ROWS > ENTRY)), SECTION)
        assert isinstance(outcome, Summarised) is fine, outcome


def test_two_metres_a_second_is_the_slowest():
    assert isinstance(summarise_passage(slowed(2.2), SECTION), Summarised)


def test_what_was_bridged_is_not_counted():
    result = summarise_passage(lost((ROWS >= ENTRY + 500) & (ROWS < ENTRY + 525)), SECTION)
    assert isinstance(result, Summarised)
    valid = (ROWS < ENTRY + 500) | (ROWS >= ENTRY + 525)
    counted = result.signals.steer_rad[result.match.inside(TRACE.time_s) & valid]
    assert result.summary.values[:11] == pytest.approx(statistics_of(counted))


def test_offsets_come_from_what_was_sensed_before_the_section_on_the_maps_grade():
    # An approach that bends a little, with a hole in it, up a hill; then a bend and a straight inside the section.
    nodes = SECTION.nodes_m.copy()
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(nodes[:, :2], axis=0).T))])
    nodes[:, 2] = np.round(0.06 * along, 3)
    steep = replace(SECTION, nodes_m=nodes)
    gravity = GRAVITY_MPS2 * np.sin(np.arctan(0.06))
    valid = ~((ROWS > 150) & (ROWS < 160))
    trace = replace(
        TRACE,
        accel_x_mps2=TRACE.accel_x_mps2 + gravity + 0.05,
        yaw_rate_radps=TRACE.yaw_rate_radps + 0.004,
        valid=valid,
    )
    result = summarise_passage(trace, steep)
    assert isinstance(result, Summarised)
    # The hole is filled by a straight line, as the client does; the rough speed takes no grade into account.
    filled = {
        name: np.interp(ROWS, ROWS[valid], getattr(trace, name)[valid])
        for name in ("accel_x_mps2", "accel_y_mps2", "yaw_rate_radps", "steer_rad")
    }
    assert result.offsets.straight_s == pytest.approx((ENTRY - 160) * 0.01, abs=0.1)
    expected = sensor_offsets(
        filled["accel_y_mps2"],
        filled["yaw_rate_radps"],
        filled["steer_rad"],
        result.signals.speed_mps,
        valid & (trace.time_s < result.match.entry_s),
        accel_x_mps2=filled["accel_x_mps2"],
        climb_rad=float(np.arctan(0.06)),
        wheelbase_m=XC90.wheelbase_m,
    )
    for name in ("yaw_rate_radps", "accel_x_mps2", "accel_y_mps2", "steer_rad"):
        assert getattr(result.offsets, name) == pytest.approx(getattr(expected, name), rel=0.01, abs=2e-6), name
