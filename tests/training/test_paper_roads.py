import numpy as np
import pytest

from roadgrip.section import BankOrigin
from roadgrip.section_file import section_to_json
from training.paper_roads import ROADS, SECTIONS_FOLDER
from training.road_design import designed_section

NAMED = {road.section_id: road for road in ROADS}


@pytest.mark.parametrize("name", NAMED)
def test_the_committed_file_is_what_the_elements_give(name):
    committed = (SECTIONS_FOLDER / f"{name}.json").read_text(encoding="utf-8")
    assert section_to_json(designed_section(NAMED[name])) == committed


@pytest.mark.parametrize(
    ("name", "length_m", "tightest_m", "speed_kph"),
    [("long-turn", 600.0, 100.0, 80.0), ("s-turn", 600.0, 55.0, 70.0), ("sharp-turn", 100.0, 20.0, 20.0)],
)
def test_length_radius_and_speed_are_the_papers(name, length_m, tightest_m, speed_kph):
    section = designed_section(NAMED[name])
    assert section.length_m == pytest.approx(length_m, abs=0.5)
    assert section.tightest_radius_m == pytest.approx(tightest_m, rel=0.03)
    assert section.speed_limit_mps * 3.6 == pytest.approx(speed_kph, abs=0.05)
    assert section.bank_origin is BankOrigin.INFERRED


@pytest.mark.parametrize("name", NAMED)
def test_the_tightest_radius_is_a_short_extreme(name):
    section = designed_section(NAMED[name])
    sharp = np.abs(section.profile.curvature_1pm) > 0.95 / section.tightest_radius_m
    assert 0.0 < sharp.mean() < 0.12


def test_the_s_turn_turns_left_for_about_300_m_and_then_right():
    curvature = designed_section(NAMED["s-turn"]).profile.curvature_1pm
    assert (curvature[30:295] > 0.0).all()
    assert (curvature[305:570] < 0.0).all()


@pytest.mark.parametrize("name", NAMED)
def test_the_carriageway_tilts_no_faster_than_a_passenger_bears(name):
    section = designed_section(NAMED[name])
    rate = np.abs(np.diff(section.profile.cross_slope_ratio)) * section.speed_limit_mps
    assert rate.max() < 0.08
