"""The command `roadgrip-train study tune`: what it writes, what it says, that it goes on."""

import json

import pytest
from typer.testing import CliRunner

from tests.training.study.generalise.road_drives import FEW, drives_on_roads
from training.cli import app
from training.study import recipes, workbench
from training.study.recipes import BEST_RECIPE, Recipe

RUNS = drives_on_roads(16)


class Bench:
    """A workbench on which the drives lie already."""

    def __init__(self, work, *, quick=False, seed=1):
        self.work = work

    def runs(self, name, grade):
        assert name == "random-roads"
        return RUNS


@pytest.fixture(autouse=True)
def inside(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(workbench, "StudyWorkbench", Bench)
    monkeypatch.setattr(recipes, "BEST_RECIPE", Recipe("best", BEST_RECIPE.features[55:70], FEW))
    return tmp_path


def invoke(*arguments: str):
    return CliRunner().invoke(app, ["study", "tune", *arguments])


def test_a_search_writes_what_it_found_where_it_says(inside):
    result = invoke("--trials", "2", "--sensors", "ideal")
    assert result.exit_code == 0, result.output
    document = json.loads((inside / "docs/results/study/tuning.json").read_text(encoding="utf-8"))
    assert document["trials_count"] == 2
    assert list(document["grounds"]) == ["ideal"]
    assert "docs/results/study/tuning.json" in result.output
    assert "other roads, ideal" in result.output


def test_a_quick_search_leaves_what_is_committed_alone(inside):
    result = invoke("--quick", "--trials", "1", "--sensors", "ideal", "--json")
    assert result.exit_code == 0, result.output
    assert not (inside / "docs").exists()
    kept = (inside / "build/study-quick/tuning.json").read_text(encoding="utf-8")
    assert json.loads(result.stdout) == json.loads(kept)


def test_both_grades_are_searched_at_once_and_the_search_goes_on(inside):
    first = json.loads(invoke("--trials", "1", "--json").stdout)
    again = json.loads(invoke("--trials", "2", "--json").stdout)
    assert set(first["grounds"]) == {"ideal", "automotive"}
    assert (first["trials_count"], again["trials_count"]) == (1, 2)
