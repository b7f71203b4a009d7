"""How far do three liars in ten move what a unit says, if they know its model and make up what passes for ordinary?

python -m bench.liars                        drives the vehicles (build/liars), then lies (`make liars`)
python -m bench.liars --drives DIR           takes drives that are there, whatever code drove them
python -m bench.liars --windows 10           fewer windows; nothing is kept without --out

Honest vehicles are simulated drives on the paper's roads and on random ones, judged by the packaged bundle. Fifteen of
fifty are then replaced by summaries crafted against that very bundle (`bench.lying.crafting`): they are in range, obey
the laws of statistics, count as ordinary driving, and claim a small expected error. The liars know what all others
said and choose, window by window, whatever moves the result furthest.

Writes docs/results/liars.json and liars.svg.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from bench.lying.crafting import LIARS_COUNT, Crafted, Wish, bounds_highest, bounds_lowest, crafted, names
from bench.lying.judged import Door, Judged, joined
from bench.lying.windows import Said, bounds_of_median_mu, median_once_changed_mu, refined_midpoint_mu, said
from bench.measurement import keep_figures, table_of
from bench.validation.picture import OURS, QUIET, THEORY, label, legend, panels, write
from roadgrip.features import TABLES
from roadgrip.section import RoadSection
from rsu_app.adapters.inference import OnnxFrictionModel, load_bundle
from training.dataset import RUNS_FILE_NAME, Runs, read_runs
from training.designs import Size, named_design
from training.scenarios import Terms
from training.simulation import drive_design
from vehicle_client.simulator.plan import SensorGrade

ROOT = Path(__file__).resolve().parents[1]
RESULTS_FOLDER = ROOT / "docs" / "results"
SEED = 7
"""Another one than the bundle's: it has never seen these random roads."""
VEHICLES_COUNT = 50
WINDOWS_COUNT = 25
BASE_FRICTIONS_MU = (0.2, 0.3, 0.45, 0.6, 0.7)
TARGETS_MU = tuple(np.geomspace(0.16, 0.72, 10).tolist())
FEWEST_HONEST_COUNT = 25
"""A cell in which fewer drives counted has no traffic to draw from."""
SHOWN_COUNT = 500
"""Windows in the picture."""
P95_LIMIT_FRAC, WORST_LIMIT_FRAC = 0.10, 0.15
DESIGNS: Mapping[str, tuple[str, Size]] = {
    "usual": ("mixed", Size(70, random_roads_count=5, random_runs_count=70)),
    "any-speed": ("any-speed", Size(70, random_roads_count=0)),
}


@dataclass(frozen=True, slots=True)
class Road:
    """A road with everything that was driven on it.

    Attributes:
        section: Its map.
        honest: Traffic that may be drawn from, by kind of driver and base friction.
        lies: What can be claimed there.
    """

    section: RoadSection
    honest: Mapping[tuple[str, float], Judged]
    lies: Sequence[Crafted]


@dataclass(frozen=True, slots=True)
class Outcome:
    """One window, before and after.

    Attributes:
        cell: Road, kind of driver and base friction.
        honest: What the unit says when nobody lies.
        named_frac: Share of the honest who name a friction.
        moved: Furthest moves down and up by estimator, relative.
        bound: How far the median could be moved whatever is said, down and up.
        lie: The lies that did it, by estimator.
        advised_kph: Advice when nobody lies, and the lowest and highest with liars.
        change_moved: Furthest moves of the median where the detector of changes is on and the liars come last.
    """

    cell: tuple[str, str, float]
    honest: Said
    named_frac: float
    moved: Mapping[str, tuple[float, float]]
    bound: tuple[float, float]
    lie: Mapping[str, tuple[str, str]]
    advised_kph: tuple[float, float, float]
    change_moved: tuple[float, float]


def driven(folder: Path, *, as_they_are: bool) -> dict[str, Runs]:
    """Return what was driven by kind of driver; drives what is not there yet.

    Args:
        folder: Of the data sets.
        as_they_are: Whether finished data sets are taken without asking which code drove them.
    """
    found = {}
    for kind, (name, size) in DESIGNS.items():
        if as_they_are:
            found[kind] = read_runs(folder / kind / RUNS_FILE_NAME)
            continue
        print(f"driving {name} into {folder / kind} (minutes; goes on where it was)", flush=True)
        found[kind] = drive_design(named_design(name, _terms(name), size), folder / kind)
    return found


def roads_of(runs: Mapping[str, Runs], model: OnnxFrictionModel, *, seed: int) -> Iterator[Road]:
    """Yield each road with its traffic and with what liars can claim on it."""
    sections = {
        scenario.section.section_id: scenario.section
        for name, size in DESIGNS.values()
        for scenario in named_design(name, _terms(name), size).scenarios
    }
    for number, (section_id, section) in enumerate(sections.items()):
        doors = {digest: Door(section, table, model) for digest, table in TABLES.items()}
        honest, pool = {}, []
        for kind, some in runs.items():
            here = np.array([each == section_id for each in some.section_id]) & some.usable
            for base_mu in BASE_FRICTIONS_MU:
                rows = np.flatnonzero(here & np.isclose(some.labels["base_friction_mu"], base_mu))
                counted = doors[some.table.digest].counted(some.features[rows][:, : len(some.table.kinematic)])
                if len(counted) >= FEWEST_HONEST_COUNT:
                    honest[kind, base_mu] = counted
            pool.append(some.rows(np.flatnonzero(here)))
        lies = []
        for digest, door in doors.items():
            table = TABLES[digest]
            everything = np.concatenate([part.for_table(table).features for part in pool])
            known = door.counted(everything[:, : len(table.kinematic)])
            rng = np.random.default_rng([seed, number, table.version])
            for name, wish in _wishes(table.version).items():
                made = crafted(door, known, wish, name=name, rng=rng)
                lies += [] if made is None else [made]
        yield Road(section, honest, lies)


def _wishes(version: int) -> dict[str, Wish]:
    wishes: dict[str, Wish] = {f"names {mu:.2f}, table {version}": names(mu) for mu in TARGETS_MU}
    wishes[f"at least as much as can be, table {version}"] = bounds_highest
    wishes[f"at least as little as can be, table {version}"] = bounds_lowest
    return wishes


def outcomes_of(road: Road, *, windows_count: int, seed: int) -> list[Outcome]:
    """Return what liars can do on a road, one window after another."""
    found = []
    for (kind, base_mu), pool in road.honest.items():
        cell = (road.section.section_id, kind, base_mu)
        for number in range(windows_count):
            rng = np.random.default_rng([seed, number, round(1000 * base_mu), len(kind)])
            found.append(_outcome(cell, road, pool.rows(rng.integers(len(pool), size=VEHICLES_COUNT)), rng))
    return found


def _outcome(cell: tuple[str, str, float], road: Road, everybody: Judged, rng: np.random.Generator) -> Outcome:
    honest = said(road.section, everybody)
    others = everybody.rows(np.arange(VEHICLES_COUNT - LIARS_COUNT))
    tries = {lie.name: lie.said for lie in road.lies} | _mixtures(road.lies, rng)
    windows = {name: joined([others, lie]) for name, lie in tries.items()}
    moves = {
        "median": {name: float(np.median(w.mu)) / honest.median_mu - 1.0 for name, w in windows.items()},
        "refined": {name: refined_midpoint_mu(w) / honest.refined_mu - 1.0 for name, w in windows.items()},
    }
    ends = {which: (min(by, key=by.__getitem__), max(by, key=by.__getitem__)) for which, by in moves.items()}
    told = {name for pair in ends.values() for name in pair} | {lie.name for lie in road.lies if "at least" in lie.name}
    advised = [said(road.section, windows[name], standing_kph=honest.advised_kph).advised_kph for name in sorted(told)]
    changed = [median_once_changed_mu(windows[name]) / honest.median_mu - 1.0 for name in ends["median"]]
    low_mu, high_mu = bounds_of_median_mu(others.mu, liars_count=LIARS_COUNT)
    return Outcome(
        cell=cell,
        honest=honest,
        named_frac=float(np.mean(~everybody.at_least)),
        moved={which: (by[ends[which][0]], by[ends[which][1]]) for which, by in moves.items()},
        bound=(low_mu / honest.median_mu - 1.0, high_mu / honest.median_mu - 1.0),
        lie=ends,
        advised_kph=(honest.advised_kph, min(advised), max(advised)),
        change_moved=(changed[0], changed[1]),
    )


def _mixtures(lies: Sequence[Crafted], rng: np.random.Generator) -> dict[str, Judged]:
    """Return lies of two sorts at once: some name a friction, the others say "at least"."""
    named = [lie for lie in lies if lie.name.startswith("names")]
    bounds = [lie for lie in lies if lie.name.startswith("at least as much")]
    if not named or not bounds:
        return {}
    highest, bound = max(named, key=lambda lie: float(np.median(lie.said.mu))), bounds[-1]
    mixed = {}
    for bounds_count in (3, 7, 11):
        chosen = rng.permutation(LIARS_COUNT)
        mixed[f"{bounds_count} say at least, the others name the most"] = joined(
            [bound.said.rows(chosen[:bounds_count]), highest.said.rows(chosen[bounds_count:])]
        )
    return mixed


def _terms(name: str) -> Terms:
    return Terms(name, SEED, SensorGrade.AUTOMOTIVE)


GROUPS: Mapping[str, Callable[[Outcome], bool]] = {
    "eight_in_ten_name_it": lambda one: one.named_frac >= 0.8,
    "four_in_ten_name_it": lambda one: not one.honest.at_least,
    "fewer_marked_at_least": lambda one: one.honest.at_least,
    "all": lambda one: one.named_frac >= 0.0,
}
"""By how many of the honest name a friction. Where fewer than four in ten do, the unit marks what it says."""


def shifts_of(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return how far liars move each estimator, in the 95th percentile and at worst, and how far the median could be.

    Args:
        outcomes: At least one.
    """
    figures: dict[str, Any] = {"windows_count": len(outcomes)}
    ends = {which: np.array([one.moved[which] for one in outcomes]) for which in ("median", "refined")}
    ends["bound_of_median"] = np.array([one.bound for one in outcomes])
    for which, moved in ends.items():
        either = np.maximum(-moved[:, 0], moved[:, 1])
        figures[which] = {
            "p95_frac": _rounded(np.percentile(either, 95)),
            "worst_frac": _rounded(either.max()),
            "down_p95_frac": _rounded(np.percentile(-moved[:, 0], 95)),
            "up_p95_frac": _rounded(np.percentile(moved[:, 1], 95)),
            "within_limits": bool(np.percentile(either, 95) <= P95_LIMIT_FRAC and either.max() <= WORST_LIMIT_FRAC),
        }
    advised = np.array([one.advised_kph for one in outcomes])
    figures["advice"] = {
        "raised_p95_kph": _rounded(np.percentile(advised[:, 2] - advised[:, 0], 95)),
        "raised_worst_kph": _rounded(np.max(advised[:, 2] - advised[:, 0])),
        "lowered_p95_kph": _rounded(np.percentile(advised[:, 0] - advised[:, 1], 95)),
        "lowered_worst_kph": _rounded(np.max(advised[:, 0] - advised[:, 1])),
    }
    changed = np.array([one.change_moved for one in outcomes])
    either = np.maximum(-changed[:, 0], changed[:, 1])
    figures["median_with_change_detection"] = {
        "p95_frac": _rounded(np.percentile(either, 95)),
        "worst_frac": _rounded(either.max()),
    }
    return figures


def figures_of(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return everything that is told of a run, for machines."""
    groups = {name: [one for one in outcomes if belongs(one)] for name, belongs in GROUPS.items()}
    cells = {cell: list(some) for cell, some in groupby(outcomes, key=lambda one: one.cell)}
    furthest = {which: max(outcomes, key=partial(_furthest_frac, which)) for which in ("median", "refined")}
    return {
        "conditions": {
            "vehicles_count": VEHICLES_COUNT,
            "liars_count": LIARS_COUNT,
            "windows_count": len(outcomes),
            "seed": SEED,
            "base_frictions_mu": list(BASE_FRICTIONS_MU),
            "liars": "know model, simulator and what all others said; choose the worst of all lies window by window",
        },
        "limits": {"p95_frac": P95_LIMIT_FRAC, "worst_frac": WORST_LIMIT_FRAC},
        "groups": {name: shifts_of(some) for name, some in groups.items() if some},
        "furthest": {
            which: {
                "cell": list(one.cell),
                "named_frac": _rounded(one.named_frac),
                "moved_frac": [_rounded(value) for value in one.moved[which]],
                "lies": list(one.lie[which]),
            }
            for which, one in furthest.items()
        },
        "cells": [
            {
                "section_id": cell[0],
                "drivers": cell[1],
                "base_friction_mu": cell[2],
                "named_frac": _rounded(np.mean([one.named_frac for one in some])),
                **{name: told for name, told in shifts_of(some).items() if name in _OF_CELLS},
            }
            for cell, some in cells.items()
        ],
    }


def _furthest_frac(which: str, one: Outcome) -> float:
    low, high = one.moved[which]
    return max(-low, high)


_OF_CELLS = ("median", "refined", "bound_of_median")


def draw(outcomes: Sequence[Outcome], folder: Path) -> None:
    """Write the picture: how far each window was moved, by how many of its honest vehicles name a friction."""
    figure, axes = panels(1, 2, title="Three liars in ten who know the model")
    for panel, which, title in zip(axes, ("median", "refined"), ("Published median", "Refined interval"), strict=True):
        shown = outcomes[:: 1 + len(outcomes) // SHOWN_COUNT]
        named = np.array([one.named_frac for one in shown])
        moved = 100.0 * np.array([one.moved[which] for one in shown])
        panel.scatter(100.0 * named, moved[:, 1], s=4, color=THEORY)
        panel.scatter(100.0 * named, moved[:, 0], s=4, color=OURS)
        for limit in (P95_LIMIT_FRAC, WORST_LIMIT_FRAC):
            for sign in (-1.0, 1.0):
                panel.axhline(sign * 100.0 * limit, color=QUIET, linewidth=0.8, linestyle="--")
        panel.axvline(40.0, color=QUIET, linewidth=0.8)
        panel.set_ylim(-80.0, 80.0)
        label(panel, title, x="honest vehicles that name a friction, %", y="midpoint moved, %")
        legend(panel, ("raised", THEORY), ("lowered", OURS), x=0.6)
    write(figure, folder, "liars")


def _rounded(value: Any) -> float:
    return round(float(value), 4)


def report(figures: Mapping[str, Any]) -> str:
    """Return the table for a person."""
    rows = [
        {
            "windows": name.replace("_", " "),
            **{
                f"{which} {word}": f"{100.0 * told[which][key]:.1f} %"
                for which in ("median", "refined")
                for word, key in (("95th", "p95_frac"), ("worst", "worst_frac"))
            },
            "bound, worst": f"{100.0 * told['bound_of_median']['worst_frac']:.1f} %",
            "advice up, 95th": f"{told['advice']['raised_p95_kph']:.0f} km/h",
        }
        for name, told in figures["groups"].items()
    ]
    return table_of(rows, number_format=".1f")


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive, lie, and write what came of it; fail where windows in which eight in ten know miss the limits."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--drives", type=Path, help="finished data sets, taken as they are")
    parser.add_argument("--windows", type=int, default=WINDOWS_COUNT, help="per road, kind of driver and friction")
    parser.add_argument("--out", type=Path, help="folder of the results; docs/results for a whole run")
    options = parser.parse_args(arguments)
    runs = driven(options.drives or ROOT / "build" / "liars", as_they_are=options.drives is not None)
    model = load_bundle(ROOT / "rsu_app" / "default_bundle")
    outcomes: list[Outcome] = []
    for road in roads_of(runs, model, seed=SEED):
        print(
            f"lying on {road.section.section_id}: {len(road.honest)} kinds of traffic, {len(road.lies)} lies",
            flush=True,
        )
        outcomes += outcomes_of(road, windows_count=options.windows, seed=SEED)
    figures = figures_of(outcomes)
    print(report(figures))
    out = options.out or (RESULTS_FOLDER if options.windows >= WINDOWS_COUNT else None)
    if out is not None:
        keep_figures(out / "liars.json", figures)
        draw(outcomes, out)
        print(f"{out / 'liars.json'}, .svg")
    known = figures["groups"]["eight_in_ten_name_it"]
    return 0 if known["median"]["within_limits"] and known["refined"]["within_limits"] else 1


if __name__ == "__main__":
    sys.exit(main())
