"""What sensors allow: the same roads for all cars, and a verdict that follows the figures."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.training.study.desk import Desk
from tests.training.study.generalise.road_drives import SMALL_BEST, drives_on_roads
from tests.training.study.results import assert_presentable, with_figures
from training.designs import Size
from training.study.generalise import sensors
from training.study.generalise.sensors import EXACT, FINER, NEW, SCHOOLED
from training.study.sources import data_set
from vehicle_client.simulator.plan import SensorGrade

IDEAL, AUTOMOTIVE = SensorGrade.IDEAL, SensorGrade.AUTOMOTIVE
ROADS_COUNT = 16


@pytest.fixture(scope="module")
def results():
    desk = Desk(
        data_sets={
            "random-roads": drives_on_roads(ROADS_COUNT + 4),
            "random-roads-new-cars": drives_on_roads(ROADS_COUNT),
            "random-roads-finer-sensors": drives_on_roads(ROADS_COUNT),
        }
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sensors, "RECIPE", SMALL_BEST)
        return {grade: sensors.compute(desk, grade) for grade in SensorGrade}


def test_all_cars_are_judged_on_the_same_roads(results):
    assert results[AUTOMOTIVE].sizes["roads"] == ROADS_COUNT
    counts = {row[-1] for row in results[AUTOMOTIVE].tables[0].rows}
    assert len(counts) == 1
    for result in results.values():
        assert_presentable(result)


def test_exact_sensors_are_judged_on_no_more_roads_than_the_others(monkeypatch):
    few = replace(data_set(sensors.NEW_CARS_SET), quick_size=Size(1, random_roads_count=ROADS_COUNT))
    monkeypatch.setattr(sensors, "data_set", lambda _name: few)
    monkeypatch.setattr(sensors, "RECIPE", SMALL_BEST)
    desk = Desk(data_sets={"random-roads": drives_on_roads(ROADS_COUNT + 4)})
    assert sensors.compute(desk, IDEAL).sizes["roads"] == ROADS_COUNT


def said(results, *, new: float, schooled: float, finer: float) -> str:
    changed = {f"mape.{NEW}": new, f"mape.{SCHOOLED}": schooled, f"mape.{FINER}": finer}
    changed |= {f"mape_util60.{name}": 0.03 for name in (NEW, SCHOOLED)}
    exact = with_figures(results[IDEAL], {f"mape.{EXACT}": 0.024})[IDEAL]
    return sensors.verdict({AUTOMOTIVE: with_figures(results[AUTOMOTIVE], changed)[AUTOMOTIVE], IDEAL: exact}).text


def test_the_verdict_says_what_remembering_gains_and_what_limits(results):
    text = said(results, new=0.1, schooled=0.09, finer=0.06)
    assert "10 % less" in text
    assert "the sensors limit" in text
    assert "come to 2.4 %" in text


def test_the_verdict_says_when_nothing_is_gained(results):
    text = said(results, new=0.1, schooled=0.11, finer=0.099)
    assert "gains nothing" in text
    assert "not what limits" in text


def test_exact_sensors_alone_say_little(results):
    assert "say nothing" in sensors.verdict({IDEAL: results[IDEAL]}).text
