"""Results for tests of verdicts: whatever figures a test needs, all others as they were computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from training.study.chapter import Result
from training.study.recipes import PAPER_FIT, PAPER_RECIPE, Boosted
from vehicle_client.simulator.plan import SensorGrade

FEW_TREES_RECIPE = replace(PAPER_RECIPE, learn=Boosted(replace(PAPER_FIT, trees_count=12, depth_count=3)))
"""The paper's in small."""


def with_figures(result: Result, figures: Mapping[str, float]) -> dict[SensorGrade, Result]:
    """Return the result for both grades, with some of its figures replaced; a figure that is not there is an error."""
    missing = set(figures) - set(result.figures)
    assert not missing, missing
    changed = replace(result, figures={**result.figures, **figures})
    return dict.fromkeys(SensorGrade, changed)


def assert_presentable(result: Result) -> None:
    """Assert that tables are rectangular, sizes positive and pictures have something to show."""
    for table in result.tables:
        assert table.rows
        assert {len(row) for row in table.rows} == {len(table.columns)}
    assert all(size >= 0 for size in result.sizes.values())
    assert len({picture.title for picture in result.pictures}) == len(result.pictures) > 0
