"""Finding the section without satellites: 1,000 random roads, automotive sensors, right maps and wrong ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from bench.onboard.chapters import Figures
from bench.onboard.matching_drives import (
    SEED,
    Driven,
    Leg,
    begun,
    driven_road,
    ended,
    left_for,
    leg_of,
    long_drive,
    surveyed,
    turned_round,
    wandering,
)
from bench.onboard.matching_pictures import draw_errors, draw_example
from bench.onboard.other_roads import (
    bends_of,
    fork,
    mirrored,
    moved_bend,
    other_angle,
    other_radius,
    part,
    profile_of,
    reversed_road,
)
from roadgrip.records import Rejected
from roadgrip.section import RoadSection
from roadgrip.units import FloatArray
from training.manoeuvres import MANOEUVRE_FRICTIONS_MU, Manoeuvre, draw_extreme_plan, draw_manoeuvre
from training.marked_tables import percent, table
from vehicle_client.mapmatch.alignment import EDGE_TOLERANCE_M
from vehicle_client.mapmatch.dead_reckoning import match_by_dead_reckoning
from vehicle_client.mapmatch.match import SectionMatch
from vehicle_client.simulator.run import simulate_passage

ROADS_COUNT = 1000
OTHERS_COUNT = 10
"""Random foreign maps per drive."""
ALIKE_AMONG_COUNT = 100
LONG_COUNT = 100
LONG_S = 600.0
MANOEUVRES_COUNT = 52
"""Of each kind."""
WANDERS = {"0.1 m, bends cut by 0.3 m": (0.1, 0.3), "0.3 m, bends cut by 1 m": (0.3, 1.0)}
ANGLE_STEPS_FRAC = (0.02, 0.05, 0.1, 0.2)
RIGHT_LIMIT_M = 30.0
"""A match farther off than this is none."""
CONFIDENCE_EDGES = (0.8, 0.9, 0.95, 0.98, 0.99, 1.0)


def draw(folder: Path) -> dict[str, Any]:
    """Return all figures of the matching and draw its two pictures."""
    everything = [driven_road(number) for number in range(ROADS_COUNT)]
    drives = [drive for drive in everything if drive.completed]
    right = {
        "with_height": right_figures([drive.leg for drive in drives], drives),
        "without_height": right_figures([drive.leg for drive in drives], drives, with_height=False),
    }
    wrong, confidences = wrong_figures(drives)
    alike = alike_figures(drives)
    figures: dict[str, Any] = {
        "roads_count": ROADS_COUNT,
        "completed_count": len(drives),
        "right": right,
        "whole_client": client_figures(drives),
        "wrong": wrong,
        "confidence": confidence_figures(drives, confidences),
        "alike": alike,
        "single_bends": single_bend_figures(drives),
        "parts": part_figures(drives),
        "aborted": aborted_figures(drives, [drive for drive in everything if not drive.completed]),
        "long_drives": long_figures(drives),
        "wandering_drivers": wander_figures(drives),
        "manoeuvres": manoeuvre_figures(),
    }
    matches = [(drive, found(drive.leg, drive.road_map)) for drive in drives]
    errors = np.array([error_of(d.leg, m, d.road_map.length_m)[1] for d, m in matches if isinstance(m, SectionMatch)])
    shares = {"ten random roads": wrong["with_height"]["accepted_frac"]} | {
        words: alike[name]["accepted_frac"] for name, words in ALIKE_WORDS.items()
    }
    figures["pictures"] = [draw_errors(folder, errors, shares), draw_example(folder, drives)]
    return figures


def found(leg: Leg, road_map: RoadSection, *, with_height: bool = True) -> SectionMatch | Rejected:
    """Return what dead reckoning makes of a drive and a map."""
    return match_by_dead_reckoning(leg.line if with_height else leg.plane_line, leg.time_s, road_map)


def error_of(leg: Leg, match: SectionMatch, length_m: float) -> tuple[float, float, float]:
    """Return true station at entry, true station less the length at exit, and the stated deviation."""
    known = np.isfinite(leg.station_m)
    # A long drive may pass the section several times: the passage that is meant is the one around the match.
    near = known & (leg.time_s >= match.entry_s - 5.0) & (leg.time_s <= match.exit_s + 5.0)
    if not near.any():
        return np.inf, np.inf, match.position_std_m
    at = np.interp([match.entry_s, match.exit_s], leg.time_s[near], leg.station_m[near])
    return float(at[0]), float(at[1]) - length_m, match.position_std_m


def right_figures(legs: Sequence[Leg], drives: Sequence[Driven], *, with_height: bool = True) -> dict[str, Any]:
    """Return how many drives find their own road, and how exactly."""
    reasons: Counter[str] = Counter()
    errors = []
    for leg, drive in zip(legs, drives, strict=True):
        outcome = found(leg, drive.road_map, with_height=with_height)
        if isinstance(outcome, Rejected):
            reasons[outcome.reason.value] += 1
        else:
            errors.append(error_of(leg, outcome, drive.road_map.length_m))
    return {"refused_frac": reasons.total() / len(legs), "reasons": dict(reasons)} | error_figures(np.array(errors))


def error_figures(errors: FloatArray) -> dict[str, Any]:
    """Return figures of errors at entry and exit, (n, 3) with the stated deviation."""
    figures: dict[str, Any] = {}
    for name, column in (("entry", 0), ("exit", 1)):
        size = np.abs(errors[:, column])
        figures |= {
            f"{name}_error_median_m": float(np.median(size)),
            f"{name}_error_q95_m": float(np.quantile(size, 0.95)),
            f"{name}_error_worst_m": float(size.max()),
        }
    both = np.abs(errors[:, :2]) / errors[:, 2:]
    return figures | {
        "stated_std_median_m": float(np.median(errors[:, 2])),
        "within_one_std_frac": float(np.mean(both <= 1.0)),
        "within_two_std_frac": float(np.mean(both <= 2.0)),
    }


def client_figures(drives: Sequence[Driven]) -> dict[str, Any]:
    """Return the share of completed drives that the whole client refuses, by reason."""
    reasons = Counter(drive.client_refusal.value for drive in drives if drive.client_refusal is not None)
    return {"refused_frac": reasons.total() / len(drives), "reasons": dict(reasons)}


def wrong_figures(drives: Sequence[Driven]) -> tuple[dict[str, Any], list[float]]:
    """Return how often random foreign maps are accepted, and the confidences of those acceptances."""
    rng = np.random.default_rng([SEED, 2])
    pairs = [(i, int(j)) for i in range(len(drives)) for j in others_of(rng, i, len(drives), OTHERS_COUNT)]
    figures: dict[str, Any] = {}
    confidences: list[float] = []
    for name, with_height in (("with_height", True), ("without_height", False)):
        matches = [found(drives[i].leg, drives[j].road_map, with_height=with_height) for i, j in pairs]
        taken = [k for k, outcome in enumerate(matches) if isinstance(outcome, SectionMatch)]
        figures[name] = {
            "pairs_count": len(pairs),
            "accepted_count": len(taken),
            "accepted_frac": len(taken) / len(pairs),
            "drives_with_one_of_ten_frac": len({pairs[k][0] for k in taken}) / len(drives),
        }
        if with_height:
            confidences = [match.confidence_frac for match in matches if isinstance(match, SectionMatch)]
    shorter = [drives[i].leg.line.distance_m[-1] < drives[j].road_map.length_m - EDGE_TOLERANCE_M for i, j in pairs]
    return figures | {"drive_shorter_than_map_frac": float(np.mean(shorter))}, confidences


def others_of(rng: np.random.Generator, i: int, count: int, chosen_count: int) -> Iterator[int]:
    """Yield so many different numbers below `count`, none of them i."""
    chosen = rng.choice(count - 1, chosen_count, replace=False)
    yield from (int(j) + (j >= i) for j in chosen)


def confidence_figures(drives: Sequence[Driven], wrong: Sequence[float]) -> list[dict[str, float]]:
    """Return by stated confidence which share of the accepted is right, at as many foreign maps as right ones."""
    own = [found(drive.leg, drive.road_map) for drive in drives]
    right = np.array([match.confidence_frac for match in own if isinstance(match, SectionMatch)])
    foreign = np.array(wrong)
    rows = []
    for low, high in pairwise(CONFIDENCE_EDGES):
        hits, misses = (float(np.sum((c >= low) & (c < high + (high == 1.0)))) for c in (right, foreign))
        rows.append(
            {
                "from_frac": low,
                "to_frac": high,
                "right_count": hits,
                "wrong_count": misses,
                "right_frac": hits / max(1e-9, hits + misses / OTHERS_COUNT),
            }
        )
    return rows


ALIKE_WORDS = {
    "most_similar_of_100": "most alike of 100",
    "mirrored": "mirrored",
    "reversed": "other direction",
    "radius_25_percent": "one radius 25 % off",
    "bend_moved_40_m": "one bend moved 40 m",
    "half_of_it": "half of it, then another",
    "bends_10_percent": "angles, radii 10 % off",
}


def alike_figures(drives: Sequence[Driven]) -> dict[str, Any]:
    """Return how often maps are accepted that are almost the right one."""
    rng = np.random.default_rng([SEED, 3])
    shapes = [profile_of(drive.section)[0][::4] for drive in drives]
    counts: dict[str, list[bool]] = {name: [] for name in ALIKE_WORDS}
    for i, drive in enumerate(drives):
        road, others = drive.section, list(others_of(rng, i, len(drives), ALIKE_AMONG_COUNT))
        nearest = max(others, key=lambda j: likeness(shapes[i], shapes[j]))
        ratio = float(rng.choice([0.75, 1.25]))
        maps = {
            "most_similar_of_100": drives[nearest].section,
            "mirrored": mirrored(road),
            "reversed": reversed_road(road),
            "radius_25_percent": other_radius(road, ratio=ratio),
            "bend_moved_40_m": moved_bend(road, by_m=40.0),
            "half_of_it": fork(road, drives[others[0]].section, own_first=bool(rng.integers(2))),
            "bends_10_percent": other_angle(road, angle_ratio=1.1, radius_ratio=1.1),
        }
        for name, foreign in maps.items():
            if foreign is not None:
                counts[name].append(isinstance(found(drive.leg, surveyed(foreign, i)), SectionMatch))
    return {name: {"maps_count": len(taken), "accepted_frac": float(np.mean(taken))} for name, taken in counts.items()}


def likeness(one: FloatArray, other: FloatArray) -> float:
    """Return the best correlation of two curvature profiles, one laid along the other."""
    product = np.correlate(one, other, mode="full")
    return float(product.max() / np.sqrt(float(one @ one) * float(other @ other)))


def single_bend_figures(drives: Sequence[Driven]) -> dict[str, Any]:
    """Return how often a road of one bend is taken for one whose bend turns by a little more, at the same radius."""
    single = [(i, d) for i, d in enumerate(drives) if len(bends_of(profile_of(d.section)[0])) == 1]
    shares = []
    for step in ANGLE_STEPS_FRAC:
        maps = [surveyed(other_angle(d.section, angle_ratio=1.0 + step, radius_ratio=1.0), i) for i, d in single]
        taken = [isinstance(found(d.leg, m), SectionMatch) for (_, d), m in zip(single, maps, strict=True)]
        shares.append({"angle_off_frac": step, "accepted_frac": float(np.mean(taken))})
    return {"roads_count": len(single), "steps": shares}


def part_figures(drives: Sequence[Driven]) -> dict[str, Any]:
    """Return how well the first and the last 70 % of a road are found as sections of their own; they were driven."""
    figures = {}
    for name, first, last in (("first_70_percent", 0.0, 0.7), ("last_70_percent", 0.3, 1.0)):
        errors, refused = [], 0
        for i, drive in enumerate(drives[::3]):
            stretch = surveyed(part(drive.section, first_frac=first, last_frac=last), i)
            outcome = found(drive.leg, stretch)
            if isinstance(outcome, Rejected):
                refused += 1
                continue
            entry, leave, std = error_of(drive.leg, outcome, stretch.length_m)
            start_m = first * drive.section.length_m
            errors.append((entry - start_m, leave - start_m, std))
        figures[name] = {"refused_frac": refused / len(drives[::3])} | error_figures(np.array(errors))
    return figures


def aborted_figures(drives: Sequence[Driven], unfinished: Sequence[Driven]) -> dict[str, Any]:
    """Return how many passages that are none are taken for one."""
    rng = np.random.default_rng([SEED, 4])
    makers: dict[str, Callable[[Driven, float, Driven], Leg]] = {
        "left_in_the_middle": lambda d, share, other: left_for(d, other, share),
        "ended_in_the_middle": lambda d, share, _: ended(d, share),
        "turned_round": lambda d, share, _: turned_round(d, share),
        "begun_in_the_middle": lambda d, share, _: begun(d, 1.0 - share),
    }
    counts: dict[str, list[bool]] = {name: [] for name in makers}
    reasons: Counter[str] = Counter()
    for i, drive in enumerate(drives):
        share = float(rng.uniform(0.3, 0.8))
        other = drives[(i + 1) % len(drives)]
        for name, maker in makers.items():
            outcome = found(maker(drive, share, other), drive.road_map)
            counts[name].append(isinstance(outcome, SectionMatch))
            if isinstance(outcome, Rejected):
                reasons[f"{name}: {outcome.reason.value}"] += 1
    taken = [isinstance(found(drive.leg, drive.road_map), SectionMatch) for drive in unfinished]
    return {name: {"drives_count": len(c), "accepted_frac": float(np.mean(c))} for name, c in counts.items()} | {
        "left_the_road": {"drives_count": len(taken), "accepted_count": sum(taken)},
        "reasons": dict(sorted(reasons.items())),
    }


def long_figures(drives: Sequence[Driven]) -> dict[str, Any]:
    """Return what becomes of ten minutes of driving that hold the section once, twice or never."""
    rng = np.random.default_rng([SEED, 5])
    figures: dict[str, Any] = {}
    for times_count, name in enumerate(("never", "once", "twice")):
        right = wrong = latest = 0
        exits = []
        for _ in range(LONG_COUNT):
            about = int(rng.integers(len(drives)))
            leg = long_drive(drives, rng, about=about, times_count=times_count, duration_s=LONG_S)
            outcome = found(leg, drives[about].road_map)
            if isinstance(outcome, Rejected):
                continue
            entry, leave, _ = error_of(leg, outcome, drives[about].road_map.length_m)
            if max(abs(entry), abs(leave)) > RIGHT_LIMIT_M:
                wrong += 1
                continue
            right += 1
            exits.append(abs(leave))
            latest += not bool(np.isfinite(leg.station_m[leg.time_s > outcome.exit_s + 30.0]).any())
        figures[name] = {"drives_count": LONG_COUNT, "right_frac": right / LONG_COUNT, "wrong_frac": wrong / LONG_COUNT}
        if times_count:
            figures[name] |= {"exit_error_median_m": float(np.median(exits)), "latest_frac": latest / max(1, right)}
    return figures


def wander_figures(drives: Sequence[Driven]) -> dict[str, Any]:
    """Return right and wrong maps for drivers who do not keep to the middle of their lane."""
    figures = {}
    for name, (wander_m, cut_m) in WANDERS.items():
        rng = np.random.default_rng([SEED, 6])
        legs = [wandering(drive, rng, wander_m=wander_m, cut_m=cut_m) for drive in drives]
        foreign = [
            found(legs[i], drives[j].road_map) for i in range(len(drives)) for j in others_of(rng, i, len(drives), 2)
        ]
        figures[name] = {"wrong_accepted_frac": float(np.mean([isinstance(f, SectionMatch) for f in foreign]))}
        figures[name] |= right_figures(legs, drives)
    return figures


def manoeuvre_figures() -> dict[str, Any]:
    """Return how many extreme manoeuvres are found; drivers there miss the line by up to metres."""
    figures = {}
    for number, kind in enumerate(Manoeuvre):
        errors, reasons, completed = [], Counter[str](), 0
        for k in range(MANOEUVRES_COUNT):
            rng = np.random.default_rng([SEED, 7, number, k])
            section = draw_manoeuvre(rng, kind, section_id=f"{kind.value}-{k}")
            mu = float(rng.choice(MANOEUVRE_FRICTIONS_MU))
            plan = draw_extreme_plan(rng, section=section, base_friction_mu=mu, with_gnss=False)
            drive = simulate_passage(section, plan)
            if not drive.completed:
                continue
            completed += 1
            leg = leg_of(drive.trace, drive.truth.station_m)
            outcome = found(leg, section)
            if isinstance(outcome, Rejected):
                reasons[outcome.reason.value] += 1
            else:
                errors.append(error_of(leg, outcome, section.length_m))
        figures[kind.value] = {
            "completed_count": completed,
            "found_frac": len(errors) / completed,
            "reasons": dict(reasons),
        }
        figures[kind.value] |= error_figures(np.array(errors))
    return figures


def _table_right(figures: Figures) -> str:
    rows = [
        ("with the height profile", figures["right"]["with_height"], figures["wrong"]["with_height"]["accepted_frac"]),
        ("without", figures["right"]["without_height"], figures["wrong"]["without_height"]["accepted_frac"]),
    ]
    rows += [
        (f"driver wanders {name}", row, row["wrong_accepted_frac"])
        for name, row in figures["wandering_drivers"].items()
    ]
    return table(
        (
            "drives",
            "right road refused",
            "wrong road accepted",
            "exit error median",
            "95 %",
            "worst",
            "within 2 stated deviations",
        ),
        [
            (
                name,
                percent(row["refused_frac"]),
                percent(wrong, digits=2),
                f"{row['exit_error_median_m']:.1f} m",
                f"{row['exit_error_q95_m']:.1f} m",
                f"{row['exit_error_worst_m']:.1f} m",
                percent(row["within_two_std_frac"], digits=0),
            )
            for name, row, wrong in rows
        ],
    )


def _table_alike(figures: Figures) -> str:
    rows = [("one of ten random roads", figures["wrong"]["with_height"]["accepted_frac"])]
    rows += [(words, figures["alike"][name]["accepted_frac"]) for name, words in ALIKE_WORDS.items()]
    rows += [
        (f"single bend, {percent(step['angle_off_frac'], digits=0)} more angle", step["accepted_frac"])
        for step in figures["single_bends"]["steps"]
    ]
    return table(("map given instead of the right one", "accepted"), [(n, percent(v, digits=2)) for n, v in rows])


def _table_other_drives(figures: Figures) -> str:
    rows = [
        (name.replace("_", " "), "none", percent(row["accepted_frac"]))
        for name, row in figures["aborted"].items()
        if "accepted_frac" in row
    ]
    rows += [
        (f"ten minutes, the section {name}", percent(row["right_frac"]), percent(row["wrong_frac"]))
        for name, row in figures["long_drives"].items()
    ]
    rows += [(kind.replace("-", " "), percent(row["found_frac"]), "") for kind, row in figures["manoeuvres"].items()]
    return table(("drive", "found rightly", "found wrongly"), rows)


TABLES: dict[str, Callable[[Figures], str]] = {
    "right": _table_right,
    "alike": _table_alike,
    "other_drives": _table_other_drives,
}
