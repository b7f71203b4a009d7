"""What became of a design, cell by cell: a cell is one scenario at one base friction."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from roadgrip.units import BoolArray, FloatArray
from training.dataset import COMPLETED, Runs
from training.rounding import rounded

DIGITS_COUNT = 6
UTILISATION_LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
REJECTED_PREFIX = "rejected_"
ALL_SCENARIOS = "all"


@dataclass(frozen=True, slots=True)
class Cell:
    """One scenario at one base friction. What is said of kept runs is None where there are none.

    Attributes:
        scenario: Its name.
        base_friction_mu: What the road offers a new tyre.
        attempts_count: Drives.
        kept_count: Drives that were completed and whose trace the onboard client took.
        feasible: Whether it has as many kept runs as were asked for; with no number asked for, whether it has any.
        outcome_count: Drives by how they ended, refusals of the onboard client by their reason.
        left_road_frac: Share of the drives.
        spun_frac: Share of the drives.
        stopped_frac: Share of the drives.
        timed_out_frac: Share of the drives.
        rejected_frac: Share of the drives that were completed, but refused by the onboard client.
        esc_runs_frac: Share of the kept runs in which yaw control intervened.
        abs_runs_frac: The same of anti-lock braking.
        tcs_runs_frac: The same of traction control.
        utilisation_ratio: Quantiles of the largest share of grip used, by their level in per cent, over kept runs.
        peak_sideslip_rad: Least, 5 %, 95 % and largest of the runs' peak sideslips, over kept runs.
        mean_speed_over_rated_ratio: Mean over kept runs.
        label_mu: Least and largest label of the kept runs.
    """

    scenario: str
    base_friction_mu: float
    attempts_count: int
    kept_count: int
    feasible: bool
    outcome_count: dict[str, int]
    left_road_frac: float
    spun_frac: float
    stopped_frac: float
    timed_out_frac: float
    rejected_frac: float
    esc_runs_frac: float | None
    abs_runs_frac: float | None
    tcs_runs_frac: float | None
    utilisation_ratio: dict[str, float] | None
    peak_sideslip_rad: dict[str, float] | None
    mean_speed_over_rated_ratio: float | None
    label_mu: dict[str, float] | None

    @property
    def kept_frac(self) -> float:
        """Share of the drives that were kept."""
        return self.kept_count / self.attempts_count


def cells_of(runs: Runs, *, kept_wanted_count: int | None = None) -> tuple[Cell, ...]:
    """Return the cells of a table of runs, scenarios in the order of the table, frictions rising.

    Args:
        runs: The table.
        kept_wanted_count: Kept runs that were asked for of each cell; None where attempts were asked for.
    """
    scenarios = np.array(runs.scenario)
    base_mu = np.round(runs.labels["base_friction_mu"], 4)
    return tuple(
        _cell(runs, rows, kept_wanted_count=kept_wanted_count)
        for scenario in dict.fromkeys(runs.scenario)
        for mu in np.unique(base_mu[scenarios == scenario])
        for rows in [np.flatnonzero((scenarios == scenario) & (base_mu == mu))]
    )


def by_friction(runs: Runs) -> Runs:
    """Return the runs as if they were of one scenario, for designs with more scenarios than a table has room for."""
    return replace(runs, scenario=(ALL_SCENARIOS,) * len(runs))


def to_json(cells: tuple[Cell, ...], *, origin: Mapping[str, str]) -> dict[str, Any]:
    """Return the cells and their sum as JSON has it, figures rounded to six digits.

    Args:
        cells: The cells of one data set.
        origin: Where it comes from: what the data set's file says of itself.
    """
    return {
        **{name: _figure(name, value) for name, value in sorted(origin.items())},
        "runs_count": sum(cell.attempts_count for cell in cells),
        "kept_count": sum(cell.kept_count for cell in cells),
        "infeasible_cells": [
            {
                "scenario": cell.scenario,
                "base_friction_mu": cell.base_friction_mu,
                "attempts_count": cell.attempts_count,
                "kept_count": cell.kept_count,
            }
            for cell in cells
            if not cell.feasible
        ],
        "cells": [rounded(asdict(cell), digits_count=DIGITS_COUNT) for cell in cells],
    }


def to_text(document: Mapping[str, Any]) -> str:
    """Return a document with tables of cells as JSON text with a line per cell, so that a difference can be read."""
    designs = [{**design, "cells": []} for design in document["designs"]]
    text = json.dumps({**document, "designs": designs}, indent=1, allow_nan=False)
    for design in document["designs"]:
        lines = ",\n".join(f"    {json.dumps(cell, allow_nan=False)}" for cell in design["cells"])
        text = text.replace('"cells": []', f'"cells": [\n{lines}\n   ]', 1)
    return text + "\n"


def _cell(runs: Runs, rows: np.ndarray[tuple[int], np.dtype[np.intp]], *, kept_wanted_count: int | None) -> Cell:
    outcomes = Counter(runs.outcome[i] for i in rows.tolist())
    attempts_count = len(rows)
    kept_rows = np.array([i for i in rows.tolist() if runs.outcome[i] == COMPLETED], dtype=np.intp)
    kept_count = len(kept_rows)
    labels = {name: values[kept_rows] for name, values in runs.labels.items()}
    rejected_count = sum(count for name, count in outcomes.items() if name.startswith(REJECTED_PREFIX))
    return Cell(
        scenario=runs.scenario[rows[0]],
        base_friction_mu=float(np.round(runs.labels["base_friction_mu"][rows[0]], 4)),
        attempts_count=attempts_count,
        kept_count=kept_count,
        feasible=kept_count >= (kept_wanted_count or 1),
        outcome_count=dict(sorted(outcomes.items())),
        left_road_frac=outcomes["left_road"] / attempts_count,
        spun_frac=outcomes["spun"] / attempts_count,
        stopped_frac=outcomes["stopped"] / attempts_count,
        timed_out_frac=outcomes["timed_out"] / attempts_count,
        rejected_frac=rejected_count / attempts_count,
        esc_runs_frac=_mean(labels["esc_active_frac"] > 0.0),
        abs_runs_frac=_mean(labels["abs_active_frac"] > 0.0),
        tcs_runs_frac=_mean(labels["tcs_active_frac"] > 0.0),
        utilisation_ratio=_quantiles(labels["peak_utilisation_ratio"], UTILISATION_LEVELS),
        peak_sideslip_rad=_quantiles(labels["peak_sideslip_rad"], (0.0, 0.05, 0.95, 1.0)),
        mean_speed_over_rated_ratio=_mean(labels["mean_speed_mps"] / labels["rated_speed_mps"]),
        label_mu=_quantiles(labels["label_mu"], (0.0, 1.0)),
    )


def _mean(values: FloatArray | BoolArray) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _quantiles(values: FloatArray, levels: tuple[float, ...]) -> dict[str, float] | None:
    """Return quantiles by their name: least, largest, or q and the level in per cent."""
    if len(values) == 0:
        return None
    names = {0.0: "least", 1.0: "largest"}
    found = np.quantile(values, levels)
    return {names.get(q, f"q{100 * q:02.0f}"): float(v) for q, v in zip(levels, found, strict=True)}


def _figure(name: str, value: str) -> str | float | None:
    """Return a number for what its name says is one; None for one that is left blank."""
    if not name.endswith(("_count", "_s", "seed")):
        return value
    return None if value == "" else float(value) if name.endswith("_s") else int(value)
