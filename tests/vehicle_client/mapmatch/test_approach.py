"""What a car decides about the passes it makes, situation by situation."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.records import Reason
from roadgrip.sections import read_section
from tests.vehicle_client.mapmatch.journeys import Journey
from vehicle_client.mapmatch.approach import TRIES_LIMIT_COUNT, Moment, Whereabouts
from vehicle_client.mapmatch.section_line import line_of_section
from vehicle_client.mapmatch.surroundings import (
    LINES_LIMIT_COUNT,
    PASSES_LIMIT_COUNT,
    OpenOrder,
    Surroundings,
)

ROAD = read_section("long-turn")
SHORT_ROAD = read_section("sharp-turn")


# With positions ------------------------------------------------------------------------------------------------------


def test_a_car_with_positions_goes_through_every_stage_and_summarises_once():
    seen: list[Whereabouts] = []
    journey = Journey(ROAD)
    for station in range(-1_400, 1_500, 20):
        journey.drive_to(station)
        if not seen or seen[-1] is not journey.whereabouts:
            seen.append(journey.whereabouts)
    assert seen == [
        Whereabouts.AWAY,
        Whereabouts.NEAR,
        Whereabouts.APPROACHING,
        Whereabouts.INSIDE,
        Whereabouts.LEAVING,
        Whereabouts.AWAY,
    ]
    assert journey.summaries == journey.passed
    assert journey.asked_count == 1


def test_a_known_section_is_announced_before_its_unit_is_heard():
    journey = Journey(ROAD, map_known=True, reach_m=0.0).drive_to(-800.0)
    assert journey.whereabouts is Whereabouts.APPROACHING
    journey.drive_to(900.0)
    assert len(journey.summaries) == 1


def test_a_section_far_ahead_is_left_alone():
    journey = Journey(ROAD, map_known=True, reach_m=0.0, station_m=-3_000.0).drive_to(-1_200.0)
    assert journey.opened_count == 0


def test_a_car_against_the_direction_is_told_nothing_of_a_section_it_knows():
    journey = Journey(ROAD, map_known=True, station_m=2_000.0).drive_to(-1_500.0)
    assert journey.opened_count == 0


def test_a_car_against_the_direction_notices_when_the_map_comes():
    journey = Journey(ROAD, station_m=2_000.0).drive_to(-1_500.0)
    assert [c.why for c in journey.closings] == [Reason.WRONG_ROAD]
    assert journey.asked_count == 0


def test_leaving_the_road_in_the_middle_ends_the_pass():
    journey = Journey(ROAD).drive_to(300.0).drive_to(500.0, lateral_m=120.0)
    assert [c.why for c in journey.closings] == [Reason.PASSAGE_ABORTED]
    assert journey.asked_count == 0


def test_one_stray_fix_does_not_end_a_pass():
    journey = Journey(ROAD).drive_to(300.0).drive_to(310.0, lateral_m=120.0).drive_to(900.0)
    assert len(journey.closings) == 1
    assert journey.closings[0].summarised or journey.closings[0].why is Reason.WRONG_ROAD
    assert journey.asked_count >= 1


def test_turning_round_in_the_middle_ends_the_pass():
    journey = Journey(ROAD).drive_to(400.0).drive_to(-1_000.0)
    assert [c.why for c in journey.closings] == [Reason.PASSAGE_ABORTED]


def test_after_turning_round_twice_the_whole_passage_counts():
    journey = Journey(ROAD).drive_to(400.0).drive_to(-1_200.0).drive_to(1_200.0)
    assert journey.summaries == journey.passed
    assert len(journey.passed) == 1


def test_standing_in_the_section_ends_the_pass():
    journey = Journey(ROAD).drive_to(300.0).stand(10.0)
    assert [c.why for c in journey.closings] == [Reason.TOO_SLOW]


@pytest.mark.parametrize("satellites", [True, False])
def test_a_queue_of_minutes_before_the_section_changes_nothing(satellites):
    journey = Journey(ROAD, satellites=satellites).drive_to(-60.0).stand(400.0).drive_to(2_500.0)
    assert journey.summaries == journey.passed
    assert len(journey.passed) == 1


def test_stopping_right_behind_the_section_still_summarises():
    journey = Journey(ROAD).drive_to(ROAD.length_m + 5.0).stand(10.0)
    assert len(journey.summaries) == 1


@pytest.mark.parametrize("satellites", [True, False])
def test_the_same_section_twice_gives_two_summaries(satellites):
    journey = Journey(ROAD, satellites=satellites)
    journey.drive_to(1_500.0).drive_elsewhere(4_000.0)
    journey.station_m = -1_500.0
    journey.drive_to(2_500.0)
    assert journey.summaries == journey.passed
    assert len(journey.passed) == 2


def test_twice_within_reach_of_the_unit_gives_two_summaries():
    journey = Journey(ROAD, satellites=False, reach_m=5_000.0)
    journey.drive_to(900.0).drive_to(-300.0).drive_to(2_500.0)
    assert journey.each_passage_was_summarised_at_most_once()
    assert journey.summaries == journey.passed


def test_a_tunnel_in_the_section_leaves_the_pass_to_the_odometer():
    journey = Journey(ROAD).drive_to(200.0).drive_to(1_200.0, satellites=False)
    assert len(journey.summaries) == 1


def test_a_tunnel_before_the_section_does_too():
    journey = Journey(ROAD).drive_to(-300.0).drive_to(2_000.0, satellites=False)
    assert len(journey.summaries) == 1


def test_a_map_that_comes_behind_the_section_is_not_too_late():
    journey = Journey(SHORT_ROAD, map_delay_s=20.0, unit_at_m=50.0).drive_to(1_500.0)
    assert len(journey.summaries) == 1


def test_a_car_that_passes_on_another_road_gives_up():
    journey = Journey(ROAD, unit_at_m=300.0, reach_m=900.0).drive_to(3_000.0, lateral_m=-400.0)
    assert not journey.summaries
    assert journey.asked_count <= 1
    assert journey.closings


# Without positions ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("road", [ROAD, SHORT_ROAD], ids=lambda road: road.section_id)
@pytest.mark.parametrize("unit_at_m", [-200.0, 0.0, 300.0])
@pytest.mark.parametrize("reach_m", [150.0, 400.0, 1_200.0])
def test_without_positions_the_section_is_found_by_beacon_and_odometer(road, unit_at_m, reach_m):
    journey = Journey(road, satellites=False, unit_at_m=unit_at_m, reach_m=reach_m).drive_to(4_000.0)
    assert journey.summaries == journey.passed
    assert journey.asked_count <= 2 * TRIES_LIMIT_COUNT


def test_without_positions_the_summary_comes_while_the_unit_is_in_reach():
    journey = Journey(ROAD, satellites=False, unit_at_m=300.0, reach_m=600.0)
    while not journey.summaries and journey.station_m < 3_000.0:
        journey.drive_to(journey.station_m + 10.0)
    assert journey.station_m < 900.0


def test_a_beacon_from_another_road_costs_few_tries():
    journey = Journey(ROAD, satellites=False, unit_at_m=300.0, reach_m=600.0)
    journey.drive_to(-600.0).drive_to(3_000.0, lateral_m=100.0)
    assert not journey.summaries
    assert journey.asked_count <= TRIES_LIMIT_COUNT
    assert [c.why for c in journey.closings] == [Reason.WRONG_ROAD]


def test_without_a_map_nothing_is_asked():
    journey = Journey(ROAD, satellites=False, map_delay_s=1e9).drive_to(6_000.0)
    assert journey.asked_count == 0
    assert [c.has_map for c in journey.closings] == [False]


def test_an_end_of_the_recording_asks_once_more():
    journey = Journey(ROAD, satellites=False, reach_m=250.0, unit_at_m=500.0).drive_to(ROAD.length_m + 1.0).finish()
    assert len(journey.summaries) == 1
    assert not journey.surroundings.passes


# Several -------------------------------------------------------------------------------------------------------------


def test_two_overlapping_sections_of_one_unit_are_two_passes():
    journey = Journey(ROAD, satellites=False)
    journey.drive_to(-50.0)
    journey.hear("other-half")
    journey.drive_to(3_000.0)
    assert {c.section_id for c in journey.closings if c.summarised} == {ROAD.section_id, "other-half"}


def test_beacons_of_more_units_than_there_is_room_for_end_the_oldest_pass():
    surroundings = Surroundings()
    for n in range(50):
        surroundings.hear(f"section-{n}", Moment(float(n), 10.0 * n, 10.0))
    assert len(surroundings.passes) == PASSES_LIMIT_COUNT
    assert surroundings.passes[-1].section_id == "section-49"


def test_sections_that_are_remembered_are_bounded():
    surroundings = Surroundings()
    line = line_of_section(ROAD)
    for n in range(100):
        surroundings.learn(type(line)(f"s-{n}", line.length_m, line.station_m, line.x_m, line.y_m, None), has_map=True)
    assert surroundings.known_count == LINES_LIMIT_COUNT


def test_a_beacon_of_an_open_pass_opens_no_second_one():
    surroundings = Surroundings()
    moment = Moment(0.0, 0.0, 10.0)
    assert surroundings.hear("bend", moment) == (OpenOrder("bend"),)
    assert surroundings.hear("bend", moment) == ()


# Laws ----------------------------------------------------------------------------------------------------------------

_LEG = st.tuples(
    st.sampled_from([-700.0, -150.0, 100.0, 350.0, 590.0, 640.0, 900.0, 1_600.0]),
    st.sampled_from([0.0, 0.0, 0.0, 90.0]),
    st.booleans(),
    st.sampled_from([0.0, 1.0, 30.0]),
)


@settings(max_examples=40, deadline=None)
@given(
    legs=st.lists(_LEG, min_size=1, max_size=7),
    reach_m=st.sampled_from([0.0, 200.0, 1_000.0]),
    map_known=st.booleans(),
    map_delay_s=st.sampled_from([0.5, 15.0]),
)
def test_whatever_is_driven_and_heard_each_passage_is_summarised_at_most_once(legs, reach_m, map_known, map_delay_s):
    journey = Journey(ROAD, reach_m=reach_m, map_known=map_known, map_delay_s=map_delay_s, speed_mps=40.0)
    journey.station_m = -400.0
    for station_m, lateral_m, satellites, standing_s in legs:
        journey.drive_to(station_m, lateral_m=lateral_m, satellites=satellites).stand(standing_s)
    journey.finish()
    assert journey.each_passage_was_summarised_at_most_once()
    assert sum(c.summarised for c in journey.closings) == len(journey.summaries)
    assert len(journey.closings) == journey.opened_count
    assert journey.asked_count <= TRIES_LIMIT_COUNT * journey.opened_count
    assert not journey.surroundings.passes
