"""Bends cut out of a surveyed mountain road: what is cut, that one can drive it, and what is where the road is not."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from roadgrip.section import BankOrigin, Direction
from roadgrip.survey import survey_line
from roadgrip.survey_fit import surveyed_course
from tests.rsu_app.road_import.surveys import EAST_M, NORTH_M, needs_roads
from training.scenarios import Scenario, Terms, attempted, run_of
from training.study import sources
from training.study.datasets import DATA_SETS, DataSet
from training.study.ringebu import ROADS_FOLDER, bends_of, cuts_of, ringebu_sections, sections_of_line
from training.study.sources import DesignSource
from vehicle_client.simulator.plan import SensorGrade
from vehicle_client.simulator.run import each_passage


def winding_line(*, wave_m: float = 400.0, waves_count: int = 12, straight_m: float = 120.0):
    """Return a line of bends to the left and to the right with straights between, vertices every 10 m."""
    station = np.arange(0.0, waves_count * (wave_m + straight_m), 1.0)
    along = np.mod(station, wave_m + straight_m)
    way = np.where(np.floor(station / (wave_m + straight_m)) % 2 == 0, 1.0, -1.0)
    curvature = np.where(along < wave_m, way * np.sin(np.pi * np.minimum(along / wave_m, 1.0)) ** 2 / 120.0, 0.0)
    heading = np.cumsum(curvature)
    x, y = np.cumsum(np.cos(heading)), np.cumsum(np.sin(heading))
    points = np.column_stack([EAST_M + x, NORTH_M + y, 500.0 + 0.03 * station])[::10]
    return survey_line(np.round(points, 1), crs="EPSG:25833")


LINE = winding_line()


def test_every_bend_of_a_line_is_found_with_its_turn():
    bends = list(bends_of(surveyed_course(LINE)))
    assert len(bends) == 12
    # Half of a raised cosine's area: 400 m / 120 m / 2.
    assert [bend.turn_rad for bend in bends] == [pytest.approx(way * 1.67, abs=0.12) for way in [1.0, -1.0] * 6]
    assert all(bend.tightest_radius_m == pytest.approx(120.0, rel=0.1) for bend in bends)


def test_pieces_do_not_overlap_and_end_where_the_line_is_straight():
    course = surveyed_course(winding_line(wave_m=150.0))
    cuts = list(cuts_of(course, np.random.default_rng(1)))
    assert len(cuts) >= 4
    assert all(before.to_m <= after.from_m for before, after in pairwise(cuts))
    ends_m = [end for cut in cuts for end in (cut.from_m, cut.to_m)]
    assert np.abs(np.interp(ends_m, course.station_m, course.curvature_1pm)).max() < 1.0 / 300.0
    assert all(50.0 <= cut.to_m - cut.from_m <= 600.0 for cut in cuts)


def test_a_section_bends_as_the_line_it_was_cut_from():
    course = surveyed_course(LINE)
    sections = sections_of_line(LINE, line_name="7")
    assert {section.direction for section in sections} == {Direction.WITH, Direction.AGAINST}
    for section in sections:
        profile, way = section.profile, 1.0 if section.direction is Direction.WITH else -1.0
        from_m = float(section.section_id.rpartition("-")[2])
        own_m = from_m + (profile.station_m if way > 0.0 else section.length_m - profile.station_m)
        there = way * np.interp(own_m, course.station_m, course.curvature_1pm)
        # Nodes lie up to 8 m apart, and the first and last piece keep the curvature of a node.
        assert profile.curvature_1pm[8:-8] == pytest.approx(there[8:-8], abs=1.5e-3)
        assert section.bank_origin is BankOrigin.INFERRED
        assert len(section.anchors) >= 2
        assert 20.0 / 3.6 <= section.speed_limit_mps + 0.01 <= 80.0 / 3.6 + 0.02


def test_the_same_line_gives_the_same_sections():
    first, again = (sections_of_line(LINE, line_name="7") for _ in range(2))
    assert [section.version for section in first] == [section.version for section in again]


def test_without_the_lines_there_are_no_sections_and_no_runs(tmp_path, monkeypatch):
    assert ringebu_sections(tmp_path) == ()
    here = next(each for each in DATA_SETS if each.name == "ringebu")
    gone = DataSet("ringebu", "ringebu", here.size, here.quick_size, here.purpose, sections=lambda: ())
    monkeypatch.setattr(sources, "DATA_SETS", (gone,))
    source = DesignSource(tmp_path, quick=True, seed=1)
    assert source.is_there("ringebu", SensorGrade.IDEAL)
    assert len(source.runs("ringebu", SensorGrade.IDEAL, lambda done, wanted: None)) == 0
    assert not list(tmp_path.iterdir())


@needs_roads
def test_the_real_road_gives_many_sections_of_the_papers_kind():
    assert ROADS_FOLDER.is_dir()
    sections = ringebu_sections()
    assert len(sections) >= 50
    assert len({section.section_id for section in sections}) == len(sections)
    for section in sections:
        assert 49.0 <= section.length_m <= 602.0
        assert 19.0 <= section.tightest_radius_m <= 520.0
        ends = section.profile.curvature_1pm[[0, -1]]
        assert np.abs(ends).max() < 1.0 / 200.0
        assert np.abs(section.profile.grade_ratio).max() < 0.2


@needs_roads
def test_the_design_drives_every_section_at_every_base_friction(tmp_path: Path):
    design = DesignSource(tmp_path, quick=True, seed=1).design("ringebu", SensorGrade.AUTOMOTIVE)
    assert [scenario.section for scenario in design.scenarios] == list(ringebu_sections())
    assert len(design.base_frictions_mu) == 11
    assert all(scenario.quota.attempts_limit_count == 1 for scenario in design.scenarios)


@pytest.mark.sim
@pytest.mark.xdist_group("sim")
@needs_roads
def test_real_bends_can_be_driven():
    terms = Terms("ringebu", 3, SensorGrade.AUTOMOTIVE)
    completed = []
    for section in ringebu_sections()[::12]:
        scenario = Scenario(section.section_id, section, attempted(1))
        plan = run_of(terms, scenario, base_friction_mu=0.7, number=0).plan
        completed += [drive.completed for drive in each_passage(section, [plan])]
    assert np.mean(completed) > 0.8
