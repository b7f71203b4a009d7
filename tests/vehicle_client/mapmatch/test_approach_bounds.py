"""The bounds of a pass, each from just within and just beyond."""

import pytest

from roadgrip.records import Reason
from roadgrip.sections import read_section
from vehicle_client.mapmatch.approach import (
    ASTRAY_S,
    HEARD_AHEAD_LIMIT_M,
    NEAR_LINE_M,
    TURNED_M,
    Moment,
    Pass,
    Whereabouts,
    heard_again,
    moved,
)
from vehicle_client.mapmatch.section_line import Place, SectionLine, line_of_section
from vehicle_client.mapmatch.surroundings import Surroundings

LINE = line_of_section(read_section("long-turn"))
START = Moment(0.0, 0.0, 15.0)


def a_pass(whereabouts: Whereabouts) -> Pass:
    return Pass(LINE.section_id, whereabouts, opened=START, heard_m=0.0, line=LINE, has_map=True, furthest_m=200.0)


def at(station_m: float, *, apart_m: float = 0.0) -> Place:
    return Place(station_m, apart_m, apart_m, to_start_m=station_m, to_end_m=LINE.length_m - station_m)


@pytest.mark.parametrize(("after_s", "over"), [(ASTRAY_S - 0.1, False), (ASTRAY_S + 0.1, True)])
def test_a_car_beside_the_line_is_astray_after_its_time(after_s: float, over: bool):
    beside = at(200.0, apart_m=NEAR_LINE_M + 1.0)
    one, _ = moved(a_pass(Whereabouts.INSIDE), Moment(10.0, 200.0, 15.0), beside)
    one, _ = moved(one, Moment(10.0 + after_s, 230.0, 15.0), beside)
    assert one.whereabouts.over is over


@pytest.mark.parametrize(("back_m", "over"), [(TURNED_M - 1.0, False), (TURNED_M + 1.0, True)])
def test_a_car_that_goes_back_inside_has_turned_round(back_m: float, over: bool):
    one, _ = moved(a_pass(Whereabouts.INSIDE), Moment(10.0, 300.0, 15.0), at(200.0 - back_m))
    assert one.whereabouts.over is over


@pytest.mark.parametrize(("back_m", "why"), [(TURNED_M - 1.0, None), (TURNED_M + 1.0, Reason.PASSAGE_ABORTED)])
def test_a_car_that_turns_right_behind_the_end_has_turned_round(back_m: float, why: Reason | None):
    one, _ = moved(a_pass(Whereabouts.LEAVING), Moment(10.0, 600.0, 15.0), at(LINE.length_m - back_m))
    assert one.why is why


@pytest.mark.parametrize("driven_m", [HEARD_AHEAD_LIMIT_M - 1.0, HEARD_AHEAD_LIMIT_M + 1_000.0])
def test_beacons_push_the_end_of_a_pass_only_so_far(driven_m: float):
    heard = heard_again(a_pass(Whereabouts.NEAR), Moment(100.0, driven_m, 15.0))
    assert heard.heard_m == min(driven_m, HEARD_AHEAD_LIMIT_M)


def test_the_line_of_a_listing_never_replaces_that_of_a_map():
    around = Surroundings()
    around.learn(LINE, has_map=True)
    coarse = SectionLine(LINE.section_id, 1.0, LINE.station_m, LINE.x_m, LINE.y_m, plane=None)
    around.learn(coarse, has_map=False)
    around.hear(LINE.section_id, START)
    (one,) = around.passes
    assert one.line is LINE
    assert one.has_map
