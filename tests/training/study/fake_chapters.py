"""Tiny chapters and data sets, for tests of what is around real ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from tests.training.runs import made_up_runs
from training.dataset import Runs
from training.study.chapter import Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.picture import Axis, Bars, Box, Boxes, Cloud, Line, Lines, Scatter
from vehicle_client.simulator.plan import SensorGrade

ROWS_COUNT = 60


@dataclass
class MadeUpSource:
    """Data sets that are made up, and change when a test says so."""

    digests: dict[str, str] = field(default_factory=dict)
    made: list[str] = field(default_factory=list)

    def digest(self, name: str, grade: SensorGrade) -> str:
        return self.digests.get(name, f"{name} {grade.value} as ever")

    def is_there(self, name: str, grade: SensorGrade) -> bool:
        return f"{name} {grade.value}" in self.made

    def runs(self, name: str, grade: SensorGrade, on_progress: Callable[[int, int], None]) -> Runs:
        self.made.append(f"{name} {grade.value}")
        on_progress(ROWS_COUNT, ROWS_COUNT)
        return made_up_runs(ROWS_COUNT)


def fake_result(*, mape: float = 0.02) -> Result:
    """Return a result with a picture of every kind, and numbers that need care."""
    x, y = (0.0, 1.0, 2.0), (mape, float("nan"), 0.3)
    return Result(
        figures={"mape": mape, "undefined": float("nan"), "headline.best.unseen_roads_mape": mape},
        sizes={"rows_count": ROWS_COUNT},
        tables=(
            Table(
                "Error | by road",
                ("road", "MAPE, %", "runs"),
                (("s-turn", 100 * mape, 12), ("<long>", None, 10_000)),
                note="a note",
            ),
        ),
        pictures=(
            Lines(
                "A line",
                Axis("n", logarithmic=True),
                Axis("%", low=0.0),
                (Line("a", x, y, low=y, high=y), Line("b", x, x)),
            ),
            Boxes(
                "Boxes",
                "road",
                Axis("%"),
                (Box("s", "one", (1.0, 2.0, 3.0, 4.0, 5.0)), Box("s", "two", (1.0, 2.0, 3.0, 4.0, 6.0))),
            ),
            Scatter(
                "Points",
                Axis("x"),
                Axis("y"),
                (Cloud("all", tuple(np.linspace(0.1, 1.0, 5000).tolist()), (0.5,) * 5000),),
            ),
            Bars("Bars </script>", "bin", Axis("count"), ("a", "b"), (("one", (1.0, 2.0)), ("two", (2.0, 1.0)))),
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Return a verdict written from the figures."""
    errors = ", ".join(f"{100 * result.figures['mape']:.1f} %" for result in results.values())
    return Verdict(Claim.PARTLY, f"It came to {errors}. The paper has 3 %.")


def fake_chapter(
    name: str,
    *,
    compute: Callable[[Workbench, SensorGrade], Result] | None = None,
    judge: Callable[[Mapping[SensorGrade, Result]], Verdict] = verdict,
    needs: tuple[str, ...] = ("paper",),
) -> Chapter:
    """Return a chapter that reads the data set "paper" and finds always the same."""

    def usual(bench: Workbench, grade: SensorGrade) -> Result:
        bench.runs("paper", grade)
        return fake_result()

    return Chapter(name, f"Does {name} work?", "It does, with 3 %.", compute or usual, judge, needs=needs)
