from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.training.runs import made_up_runs
from training.cell_pictures import draw_cells
from training.cells import by_friction, cells_of, to_json, to_text
from training.dataset import LABEL_COLUMNS, Runs

OUTCOMES = (
    "completed",
    "left_road",
    "completed",
    "spun",
    "rejected_wrong_road",
    "completed",
    "rejected_too_slow",
    "left_road",
)


@pytest.fixture(scope="module")
def runs() -> Runs:
    """Eight drives of one cell, of which three were kept, and eight of another that all left the road."""
    count = 2 * len(OUTCOMES)
    labels = {name: np.ones(count) for name in LABEL_COLUMNS}
    labels["base_friction_mu"] = np.repeat([0.3, 0.2], count // 2)
    labels["esc_active_frac"] = np.tile([0.1, 0.9, 0.0, 0.9, 0.9, 0.0, 0.9, 0.9], 2)
    labels["abs_active_frac"] = labels["tcs_active_frac"] = np.zeros(count)
    labels["peak_utilisation_ratio"] = np.tile([0.4, 1.0, 0.5, 1.0, 1.0, 0.6, 1.0, 1.0], 2)
    labels["peak_sideslip_rad"] = np.tile([0.01, 1.0, 0.02, 1.0, 1.0, 0.03, 1.0, 1.0], 2)
    labels["mean_speed_mps"] = np.full(count, 15.0)
    labels["rated_speed_mps"] = np.full(count, 20.0)
    return replace(
        made_up_runs(count),
        labels=labels,
        scenario=("bend",) * count,
        outcome=OUTCOMES + ("left_road",) * (count // 2),
    )


def test_a_cell_counts_every_drive_once_and_says_why_the_others_failed(runs: Runs) -> None:
    cell = cells_of(runs)[1]
    assert (cell.scenario, cell.base_friction_mu) == ("bend", 0.3)
    assert (cell.attempts_count, cell.kept_count) == (8, 3)
    assert cell.outcome_count == {
        "completed": 3,
        "left_road": 2,
        "rejected_too_slow": 1,
        "rejected_wrong_road": 1,
        "spun": 1,
    }
    shares = [cell.left_road_frac, cell.spun_frac, cell.stopped_frac, cell.timed_out_frac, cell.rejected_frac]
    assert shares == [0.25, 0.125, 0.0, 0.0, 0.25]
    assert cell.kept_frac + sum(shares) == 1.0


def test_how_hard_it_was_is_said_of_kept_runs_alone(runs: Runs) -> None:
    cell = cells_of(runs)[1]
    assert cell.esc_runs_frac == pytest.approx(1 / 3)
    assert cell.utilisation_ratio is not None
    assert cell.utilisation_ratio["q50"] == 0.5
    assert cell.peak_sideslip_rad is not None
    assert (cell.peak_sideslip_rad["least"], cell.peak_sideslip_rad["largest"]) == (0.01, 0.03)
    assert cell.mean_speed_over_rated_ratio == 0.75


def test_a_cell_without_kept_runs_says_nothing_of_them(runs: Runs) -> None:
    cell = cells_of(runs)[0]
    assert cell.kept_count == 0
    assert [cell.esc_runs_frac, cell.utilisation_ratio, cell.peak_sideslip_rad, cell.label_mu] == [None] * 4


def test_a_cell_with_fewer_kept_runs_than_were_asked_for_is_infeasible_and_listed_with_its_count(runs: Runs) -> None:
    assert [cell.feasible for cell in cells_of(runs, kept_wanted_count=3)] == [False, True]
    cells = cells_of(runs, kept_wanted_count=4)
    assert [cell.feasible for cell in cells] == [False, False]
    listed = to_json(cells, origin={})["infeasible_cells"]
    assert [(cell["base_friction_mu"], cell["attempts_count"], cell["kept_count"]) for cell in listed] == [
        (0.2, 8, 0),
        (0.3, 8, 3),
    ]


def test_the_json_says_where_the_cells_come_from_and_holds_no_figure_that_json_does_not_know(runs: Runs) -> None:
    origin = {"seed": "7", "wall_s": "2.5", "dataset_digest": "1234567890123456", "kept_wanted_count": ""}
    told = to_json(cells_of(runs), origin=origin)
    text = to_text({"designs": [told, told]})
    assert len(text.splitlines()) < 60
    document, again = json.loads(text)["designs"]
    assert document == again == told
    assert {name: document[name] for name in origin} == {
        "seed": 7,
        "wall_s": 2.5,
        "dataset_digest": "1234567890123456",
        "kept_wanted_count": None,
    }
    assert (document["runs_count"], document["kept_count"], len(document["cells"])) == (16, 3, 2)


def test_runs_of_many_scenarios_can_be_told_by_friction_alone() -> None:
    runs = made_up_runs(30)
    (cell,) = cells_of(by_friction(runs))
    assert len(cells_of(runs)) == 3
    assert (cell.attempts_count, cell.kept_count) == (30, 27)


def test_a_picture_is_the_same_for_the_same_cells(runs: Runs, tmp_path) -> None:
    for name in ("one.svg", "two.svg"):
        draw_cells({"made up": cells_of(runs, kept_wanted_count=3)}, tmp_path / name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
    text = (tmp_path / "one.svg").read_text(encoding="utf-8")
    assert "bend" in text
    assert "0*" in text  # the infeasible cell
