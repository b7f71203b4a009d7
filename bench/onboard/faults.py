"""What the onboard client notices of sensors that lie, and how seldom it blames those that do not.

python -m bench.onboard.faults      remake the tables of docs/sensors.md alone (a minute)

As a chapter of the accuracy study it returns the same figures.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.onboard.good_drives import Good, good_drives
from roadgrip.records import QualityFlag, Reason, Rejected
from roadgrip.units import SAMPLE_RATE_HZ
from training.marked_tables import table, with_tables
from vehicle_client.estimation.plausibility import findings
from vehicle_client.estimation.trace import GnssTrack, Trace
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.simulator.plan import SensorGrade

PAGE = Path(__file__).resolve().parents[2] / "docs" / "sensors.md"
EXTREMES = {"slalom", "lane-change", "ninety-degrees", "sine"}
PER_MAGNITUDE_COUNT = 24
FAULT_AT_FRAC = 0.4
"""Of the section's length, where a fault sets in that does not last throughout."""
_METRES_PER_DEG = 111_320.0

Break = Callable[[Trace, int], Trace]


def _gyro_scaled(ratio: float) -> Break:
    return lambda trace, _: replace(trace, yaw_rate_radps=trace.yaw_rate_radps * ratio)


def _steering_off(jump_rad: float) -> Break:
    return lambda trace, at: replace(trace, steer_rad=trace.steer_rad + jump_rad * _from(trace, at))


def _steering_wanders(by_rad: float) -> Break:
    def broken(trace: Trace, at: int) -> Trace:
        share = np.clip((np.arange(trace.samples_count) - at) / SAMPLE_RATE_HZ, 0.0, 1.0)
        return replace(trace, steer_rad=trace.steer_rad + by_rad * share)

    return broken


def _accel_off(offset_mps2: float) -> Break:
    return lambda trace, at: replace(trace, accel_y_mps2=trace.accel_y_mps2 + offset_mps2 * _from(trace, at))


def _wheels_scaled(ratio: float) -> Break:
    return lambda trace, _: replace(trace, wheel_speed_mps=trace.wheel_speed_mps * ratio)


def _fixes_late(by_s: float) -> Break:
    return lambda trace, _: _with_fixes(trace, lambda gnss, _: replace(gnss, time_s=gnss.time_s + by_s), 0)


def _fixes_jump(by_m: float) -> Break:
    def moved(gnss: GnssTrack, at_s: float) -> GnssTrack:
        return replace(gnss, lat_deg=gnss.lat_deg + np.where(gnss.time_s >= at_s, by_m / _METRES_PER_DEG, 0.0))

    return lambda trace, at: _with_fixes(trace, moved, at)


def _with_fixes(trace: Trace, changed: Callable[[GnssTrack, float], GnssTrack], at: int) -> Trace:
    return trace if trace.gnss is None else replace(trace, gnss=changed(trace.gnss, float(trace.time_s[at])))


def _from(trace: Trace, at: int) -> np.typing.NDArray[np.bool_]:
    return np.arange(trace.samples_count) >= at


MAGNITUDES: Mapping[str, Break] = {
    "gyro scale -30 %": _gyro_scaled(0.7),
    "gyro scale -10 %": _gyro_scaled(0.9),
    "gyro scale -5 %": _gyro_scaled(0.95),
    "gyro scale +5 %": _gyro_scaled(1.05),
    "gyro scale +10 %": _gyro_scaled(1.1),
    "gyro scale +30 %": _gyro_scaled(1.3),
    "steering jumps by 0.005 rad": _steering_off(0.005),
    "steering jumps by 0.01 rad": _steering_off(0.01),
    "steering jumps by 0.02 rad": _steering_off(0.02),
    "steering jumps by 0.05 rad": _steering_off(0.05),
    "steering wanders by 0.01 rad within 1 s": _steering_wanders(0.01),
    "steering wanders by 0.02 rad within 1 s": _steering_wanders(0.02),
    "lateral acceleration off by 1 m/s²": _accel_off(1.0),
    "lateral acceleration off by 3 m/s²": _accel_off(3.0),
    "lateral acceleration off by 6 m/s²": _accel_off(6.0),
    "all wheels -2 %": _wheels_scaled(0.98),
    "all wheels -5 %": _wheels_scaled(0.95),
    "all wheels -15 %": _wheels_scaled(0.85),
    "fixes late by 0.5 s": _fixes_late(0.5),
    "fixes late by 1 s": _fixes_late(1.0),
    "fixes late by 2 s": _fixes_late(2.0),
    "fixes jump by 10 m": _fixes_jump(10.0),
    "fixes jump by 30 m": _fixes_jump(30.0),
}


def draw(folder: Path) -> dict[str, Any]:  # noqa: ARG001 - a chapter without pictures
    """Return how often good sensors are blamed, how near they come, and what is noticed of bad ones."""
    good = list(good_drives())
    outcomes = [summarise_passage(one.drive.trace, one.road_map, vehicle=one.vehicle) for one in good]
    judged = list(zip(good, outcomes, strict=True))
    sent = [one for one, outcome in judged if isinstance(outcome, Summarised)]
    return {"good": _false_alarms(judged), "sizes": _sizes(judged), "magnitudes": _detection(sent)}


Judged = tuple[Good, Summarised | Rejected]


def _false_alarms(judged: Iterable[Judged]) -> dict[str, dict[str, int]]:
    """Return how many drives there were, by kind, and how many of them were blamed for anything."""
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for one, outcome in judged:
        here = counts[_kind(one)]
        here["drives"] += 1
        if isinstance(outcome, Rejected):
            here["sensor_fault"] += outcome.reason is Reason.SENSOR_FAULT
            here["other_refusal"] += outcome.reason is not Reason.SENSOR_FAULT
            continue
        here["doubtful"] += QualityFlag.SENSORS_DOUBTFUL in outcome.summary.quality
        here["gnss_poor"] += QualityFlag.GNSS_POOR in outcome.summary.quality
    names = ("drives", "sensor_fault", "doubtful", "gnss_poor", "other_refusal")
    by_kind = {kind: {name: counts[kind][name] for name in names} for kind in sorted(counts)}
    by_kind["all"] = {name: sum(row[name] for row in by_kind.values()) for name in names}
    return by_kind


def _sizes(judged: Iterable[Judged]) -> list[dict[str, Any]]:
    """Return the largest size that every check within the car found with good sensors, beside its limits."""
    largest: dict[str, dict[str, Any]] = {}
    for one, outcome in judged:
        if not isinstance(outcome, Summarised):
            continue
        found = findings(
            one.drive.trace,
            outcome.signals.speed_mps,
            from_s=outcome.match.entry_s,
            to_s=outcome.match.exit_s,
            vehicle=one.vehicle,
        )
        for finding in found:
            what = finding.what.partition(" (")[0].partition(" than force")[0].partition(" than steering")[0]
            name = f"{finding.sensor.value} {what}"
            row = largest.setdefault(name, {"check": name, "largest": 0.0, "largest_extreme": 0.0})
            column = "largest_extreme" if one.kind in EXTREMES else "largest"
            row[column] = max(row[column], float(finding.found_value))
            row |= {"doubtful_from": finding.level.doubtful_value, "grave_from": _finite(finding.level.grave_value)}
    return [largest[name] for name in sorted(largest)]


def _detection(sent: Iterable[Good]) -> list[dict[str, Any]]:
    """Return what becomes of the same drives with faults of growing size."""
    usual = [one for one in sent if one.kind not in EXTREMES and one.drive.plan.sensor_grade is SensorGrade.AUTOMOTIVE]
    rows = []
    for positions in (False, True):
        having = [one for one in usual if (one.drive.trace.gnss is not None) is positions]
        every = max(1, len(having) // PER_MAGNITUDE_COUNT)
        chosen = having[::every]
        for name, broken in MAGNITUDES.items():
            if not positions and name.startswith("fixes"):
                continue
            counts = Counter(_fate(one, broken) for one in chosen)
            total = sum(counts.values())
            shares = {fate: counts[fate] / total for fate in ("unmarked", "marked", "sensor_fault", "other_refusal")}
            rows.append({"fault": name, "positions": positions, "drives": total} | shares)
    return rows


def _fate(one: Good, broken: Break) -> str:
    truth = one.drive.truth
    at = int(np.searchsorted(truth.station_m, FAULT_AT_FRAC * one.section.length_m))
    outcome = summarise_passage(broken(one.drive.trace, at), one.road_map, vehicle=one.vehicle)
    if isinstance(outcome, Rejected):
        return "sensor_fault" if outcome.reason is Reason.SENSOR_FAULT else "other_refusal"
    marks = QualityFlag.SENSORS_DOUBTFUL | QualityFlag.GNSS_POOR
    return "marked" if outcome.summary.quality & marks else "unmarked"


def _kind(one: Good) -> str:
    group = "extreme manoeuvres" if one.kind in EXTREMES else "other drives"
    positions = "with positions" if one.drive.trace.gnss is not None else "without"
    return f"{group}, {one.drive.plan.sensor_grade.value} sensors, {positions}"


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _good_table(figures: Mapping[str, Any]) -> str:
    head = ("good drives", "number", "`sensor_fault`", "`SENSORS_DOUBTFUL`", "`GNSS_POOR`", "not found")
    names = ("drives", "sensor_fault", "doubtful", "gnss_poor", "other_refusal")
    return table(head, [(kind, *(str(row[name]) for name in names)) for kind, row in figures["good"].items()])


def _size_table(figures: Mapping[str, Any]) -> str:
    head = ("check", "good sensors reach", "in extreme manoeuvres", "doubtful from", "fault from")
    rows = []
    for row in figures["sizes"]:
        grave = "never" if row["grave_from"] is None else f"{row['grave_from']:g}"
        rows.append(
            (row["check"], f"{row['largest']:.2g}", f"{row['largest_extreme']:.2g}", f"{row['doubtful_from']:g}", grave)
        )
    return table(head, rows)


def _magnitude_table(figures: Mapping[str, Any]) -> str:
    by_name: dict[str, dict[bool, str]] = defaultdict(dict)
    for row in figures["magnitudes"]:
        shares = (row["unmarked"], row["marked"], row["sensor_fault"], row["other_refusal"])
        by_name[row["fault"]][row["positions"]] = " / ".join(f"{100.0 * share:.0f}" for share in shares)
    head = ("fault", "without positions", "with positions")
    return table(head, [(name, cells.get(False, ""), cells[True]) for name, cells in by_name.items()])


TABLES = {"good": _good_table, "sizes": _size_table, "magnitudes": _magnitude_table}


def main() -> None:
    """Remake the tables of the page."""
    figures = draw(PAGE.parent)
    page = with_tables(PAGE.read_text(encoding="utf-8"), lambda name: TABLES[name.partition(".")[2]](figures))
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
