"""Where the client thinks that a section begins and ends, against where it does; and which passages it refuses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.onboard.chapters import Figures
from bench.onboard.drives import GRADES, SCENARIO_WORDS, SEED, attempted_drives, study_scenarios
from bench.validation.picture import OURS, QUIET, SERIES, THEORY, label, legend, panels, write
from roadgrip.records import Rejected
from roadgrip.section import RoadSection
from training.chance import chance
from training.designs import BASE_FRICTIONS_MU, random_roads
from training.marked_tables import percent, table
from training.scenarios import Scenario, attempted
from vehicle_client.mapmatch.match import SectionMatch
from vehicle_client.pipeline import summarise_passage
from vehicle_client.simulator.drive import Drive
from vehicle_client.simulator.plan import SensorGrade

DRIVES_COUNT = 24
"""Per cell: scenario, base friction, grade of sensors."""
ROADS_COUNT = 250
RANDOM = "random_roads"
WORDS = SCENARIO_WORDS | {RANDOM: f"{ROADS_COUNT} random roads"}
WAYS = {"gnss": "with fixes", "no_gnss": "without"}
COVERED_SIGMAS = 2.0


@dataclass(frozen=True, slots=True)
class Placed:
    """One match against the truth.

    Attributes:
        entry_error_m: True station where the client thinks the section begins.
        exit_error_m: True station less the section's length where it thinks it ends.
        along_rms_m: Root mean square of the station's error inside the section.
        stated_std_m: What the match says of itself.
    """

    entry_error_m: float
    exit_error_m: float
    along_rms_m: float
    stated_std_m: float


@dataclass
class Tally:
    """What became of the drives of some cells, one way of matching.

    Attributes:
        placed: Completed drives that were matched.
        reasons: Completed drives that were refused, by reason.
        unfinished_count: Drives that left the road.
        unfinished_taken_count: Those of them that the client took for passages.
    """

    placed: list[Placed] = field(default_factory=list)
    reasons: Counter[str] = field(default_factory=Counter)
    unfinished_count: int = 0
    unfinished_taken_count: int = 0

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            self.placed + other.placed,
            self.reasons + other.reasons,
            self.unfinished_count + other.unfinished_count,
            self.unfinished_taken_count + other.unfinished_taken_count,
        )

    @property
    def completed_count(self) -> int:
        """Drives that passed the section and its exit."""
        return len(self.placed) + sum(self.reasons.values())


def placed(match: SectionMatch, drive: Drive, section: RoadSection) -> Placed:
    """Return how a match lies against the truth.

    Args:
        match: From the client.
        drive: What was driven, over the whole section.
        section: What was driven on.
    """
    truth = drive.truth
    entry, leave = np.interp([match.entry_s, match.exit_s], truth.time_s, truth.station_m)
    inside = (truth.station_m >= 0.0) & (truth.station_m <= section.length_m)
    error = (match.station_m - truth.station_m)[inside]
    return Placed(
        entry_error_m=float(entry),
        exit_error_m=float(leave - section.length_m),
        along_rms_m=float(np.sqrt(np.mean(error**2))),
        stated_std_m=match.position_std_m,
    )


def error_figures(found: Sequence[Placed]) -> dict[str, float | int]:
    """Return median, 95 % and worst of the magnitudes, and how often the true error is within two stated deviations.

    Args:
        found: At least one.
    """
    figures: dict[str, float | int] = {"passages_count": len(found)}
    stated = np.array([one.stated_std_m for one in found])
    for end in ("entry", "exit"):
        size = np.abs([getattr(one, f"{end}_error_m") for one in found])
        figures |= {
            f"{end}_q50_m": float(np.median(size)),
            f"{end}_q95_m": float(np.quantile(size, 0.95)),
            f"{end}_largest_m": float(size.max()),
            f"{end}_within_two_stated_frac": float(np.mean(size <= COVERED_SIGMAS * stated)),
        }
    figures["along_rms_q50_m"] = float(np.median([one.along_rms_m for one in found]))
    figures["stated_std_q50_m"] = float(np.median(stated))
    return figures


def draw(folder: Path) -> dict[str, Any]:
    """Draw the errors of entry and exit; return all figures.

    Args:
        folder: Where pictures go.
    """
    figures: dict[str, Any] = {
        "seed": SEED,
        "drives_per_cell_count": DRIVES_COUNT,
        "random_roads_count": ROADS_COUNT,
        "grades": {},
    }
    shown: dict[tuple[str, str], list[Placed]] = {}
    for grade in GRADES:
        found = {}
        for name, cells in _roads(grade):
            print(f"    positions: {grade}, {name}", flush=True)
            by_cell = dict(cells)
            found[name] = {way: _figures(way, by_cell) for way in WAYS}
            if grade is SensorGrade.AUTOMOTIVE:
                shown |= {(name, way): _whole(way, by_cell).placed for way in WAYS}
        figures["grades"][grade.value] = found
    figures["picture"] = _draw(shown, folder)
    return figures


Cells = dict[str, dict[str, Tally]]


def _roads(grade: SensorGrade) -> Iterable[tuple[str, Iterable[tuple[str, dict[str, Tally]]]]]:
    """Yield the paper's scenarios, cell by cell, and random roads, each once at a friction of its own."""
    for scenario in study_scenarios():
        yield scenario.name, ((f"{mu:.2f}", _cell(scenario, grade, mu, DRIVES_COUNT)) for mu in BASE_FRICTIONS_MU)
    roads = random_roads(SEED, ROADS_COUNT, attempted(1))
    frictions = chance(SEED, "positions").choice(BASE_FRICTIONS_MU, ROADS_COUNT).tolist()
    yield (
        RANDOM,
        ((road.name, _cell(road, grade, mu, 1)) for road, mu in zip(roads, frictions, strict=True)),
    )


def _cell(scenario: Scenario, grade: SensorGrade, base_friction_mu: float, drives_count: int) -> dict[str, Tally]:
    tallies = {way: Tally() for way in WAYS}
    for run, drive, road_map in attempted_drives(
        scenario, grade, base_friction_mu=base_friction_mu, drives_count=drives_count
    ):
        for way, tally in tallies.items():
            trace = drive.trace if way == "gnss" else replace(drive.trace, gnss=None)
            result = summarise_passage(trace, road_map, vehicle=run.geometry)
            refused = isinstance(result, Rejected)
            if not drive.completed:
                tally.unfinished_count += 1
                tally.unfinished_taken_count += not refused
            elif isinstance(result, Rejected):
                tally.reasons[result.reason.value] += 1
            else:
                tally.placed.append(placed(result.match, drive, scenario.section))
    return tallies


def _whole(way: str, cells: Cells) -> Tally:
    return sum((cell[way] for cell in cells.values()), Tally())


def _figures(way: str, cells: Cells) -> dict[str, Any]:
    whole = _whole(way, cells)
    return {
        "completed_count": whole.completed_count,
        "refused_count": sum(whole.reasons.values()),
        "refused_by_reason_count": dict(sorted(whole.reasons.items())),
        "refused_by_cell_count": {
            name: dict(sorted(cell[way].reasons.items())) for name, cell in cells.items() if cell[way].reasons
        },
        "left_road_count": whole.unfinished_count,
        "left_road_but_taken_count": whole.unfinished_taken_count,
        "errors": error_figures(whole.placed) if whole.placed else None,
    }


def _draw(shown: dict[tuple[str, str], list[Placed]], folder: Path) -> str:
    figure, axes = panels(1, 2, title="Where a section ends: client against truth, automotive sensors")
    colours = dict(zip(WORDS, (*SERIES[:3], SERIES[3], THEORY), strict=True))
    for (name, way), found in shown.items():
        size = np.sort(np.abs([one.exit_error_m for one in found]))
        beyond = 1.0 - np.arange(len(size)) / len(size)
        axes[0].step(size, beyond, where="post", color=colours[name], linestyle="-" if way == "no_gnss" else ":")
    axes[0].set_xscale("log")
    axes[0].set_yscale("log")
    axes[0].set_xticks([0.1, 0.3, 1.0, 3.0, 10.0, 30.0], ["0.1", "0.3", "1", "3", "10", "30"])
    axes[0].set_xlim(0.05, 40.0)
    axes[0].set_yticks([1.0, 0.3, 0.1, 0.03, 0.01], ["100 %", "30 %", "10 %", "3 %", "1 %"])
    label(axes[0], "Passages whose exit is off by more", x="error of the exit, m", y="share of the passages")
    legend(
        axes[0],
        *((WORDS[name], colour) for name, colour in colours.items()),
        ("dotted: with position fixes", QUIET),
        top=0.45,
    )
    for way, colour in (("gnss", THEORY), ("no_gnss", OURS)):
        found = shown[RANDOM, way]
        axes[1].plot(
            [one.stated_std_m for one in found],
            [abs(one.exit_error_m) for one in found],
            "o" if way == "no_gnss" else "^",
            color=colour,
            markersize=2.5,
            alpha=0.6,
        )
    ends = np.array([0.5, 20.0])
    axes[1].plot(ends, COVERED_SIGMAS * ends, color=QUIET, linewidth=1.0)
    axes[1].set_xscale("log")
    axes[1].set_yscale("log")
    axes[1].set_xlim(0.5, 20.0)
    axes[1].set_ylim(0.01, 40.0)
    axes[1].set_xticks([0.5, 1.0, 2.0, 5.0, 10.0, 20.0], ["0.5", "1", "2", "5", "10", "20"])
    axes[1].minorticks_off()
    label(axes[1], "Is the stated deviation true? Random roads", x="stated, m", y="error of the exit, m")
    legend(axes[1], ("without fixes", OURS), ("with", THEORY), ("line: twice what is stated", QUIET), x=0.6, top=0.25)
    return write(figure, folder, "positions")


def _errors_table(figures: Figures) -> str:
    rows = []
    for grade in GRADES:
        for name, words in WORDS.items():
            for way, way_words in WAYS.items():
                found = figures["grades"][grade.value][name][way]["errors"]
                ends = [
                    " / ".join(f"{found[f'{end}_{q}_m']:.1f}" for q in ("q50", "q95", "largest"))
                    for end in ("entry", "exit")
                ]
                covered = min(found[f"{end}_within_two_stated_frac"] for end in ("entry", "exit"))
                rows.append(
                    [
                        f"{words}, {grade}, {way_words}",
                        f"{found['passages_count']}",
                        *ends,
                        f"{found['stated_std_q50_m']:.1f}",
                        percent(covered, digits=0),
                    ]
                )
    head = (
        "drives",
        "passages",
        "entry, m: median / 95 % / worst",
        "exit, m",
        "stated deviation, m",
        "within two of it",
    )
    return table(head, rows)


def _headline_table(figures: Figures) -> str:
    rows = []
    for name, words in WORDS.items():
        for way, way_words in WAYS.items():
            found = figures["grades"][SensorGrade.AUTOMOTIVE.value][name][way]
            errors = found["errors"]
            ends = (" / ".join(f"{errors[f'{end}_{q}_m']:.1f}" for q in ("q50", "q95")) for end in ("entry", "exit"))
            refused = found["refused_count"] / found["completed_count"]
            rows.append([f"{words}, {way_words}", *ends, percent(refused)])
    return table(("automotive sensors", "entry, m: median / 95 %", "exit, m: median / 95 %", "refused"), rows)


def _refused_table(figures: Figures) -> str:
    rows = []
    for grade in GRADES:
        for name, words in WORDS.items():
            found = [figures["grades"][grade.value][name][way] for way in WAYS]
            rows.append(
                [f"{words}, {grade}", f"{found[0]['completed_count']}"]
                + [_reasons(one) for one in found]
                + [f"{found[0]['left_road_count']}"]
                + [f"{one['left_road_but_taken_count']}" for one in found]
            )
    head = (
        "drives",
        "completed",
        "refused, with fixes",
        "refused, without",
        "left the road",
        "yet taken, with fixes",
        "yet taken, without",
    )
    return table(head, rows)


def _reasons(found: Figures) -> str:
    if found["refused_count"] == 0:
        return "none"
    return ", ".join(
        f"{percent(count / found['completed_count'])} `{reason}`"
        for reason, count in found["refused_by_reason_count"].items()
    )


TABLES = {"headline": _headline_table, "errors": _errors_table, "refused": _refused_table}
