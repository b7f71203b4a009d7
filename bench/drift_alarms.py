"""How often drift is told of traffic that did not drift, and of traffic that did; the table of docs/drift.md.

python bench/drift_alarms.py               drives, judges, prints the table and writes it into docs/drift.md; minutes
python bench/drift_alarms.py --drives 60   a fifth of the drives, windows of 50 only, nothing written

Simulated cars pass one section. Every hour has one friction. Some hours teach the section's baseline; windows of 50
and of 256 passages of other hours are then judged as a unit judges them. Beside that stands how often an alarm would
come if the training on the very same road decided, in the same way.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from importlib.resources import files
from os import cpu_count
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

if __name__ == "__main__":
    # As a script the folder of this file is searched; the package `bench` lies beside it.
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from roadgrip.bundle import ModelManifest
from roadgrip.features import NEWEST_TABLE, road_features
from roadgrip.records import Rejected
from roadgrip.sections import read_section
from roadgrip.units import BoolArray, FloatArray
from rsu_app.domain.drift import BandReference, DriftAlarm, DriftPolicy, drift_report
from rsu_app.domain.envelope import is_strange_driving, is_strange_road
from rsu_app.domain.section_baseline import learned_bands
from training.chance import chance
from training.drift.reference import learn_references
from training.evaluation_bundle import Bundle, read_bundle
from training.export import onnx_estimate_mu
from training.marked_tables import percent, table, with_tables
from training.scenarios import Terms, surveyed_map
from training.workers import executor
from vehicle_client.pipeline import summarise_passage
from vehicle_client.simulator.plan import DECLARED_NOISE, PassagePlan, SensorGrade, draw_plan
from vehicle_client.simulator.run import each_passage

PAGE = Path(__file__).resolve().parents[1] / "docs" / "drift.md"
TABLE_NAME = "drift_alarms"
SECTION, OTHER_SECTION = "s-turn", "long-turn"
FRICTIONS_MU = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
SEED = 7
WINDOWS_COUNTS = (50, 256)
BASELINES_COUNT, TRIALS_COUNT = 10, 20
BASELINE_HOURS_COUNT, HOURLY_COUNT = 72, 60
GYRO_RATIOS = {"gyro 2 %": 1.02, "gyro 5 %": 1.05}
SPEED_RATIO = 1.2
LEARNED, FRESH = "learned", "fresh"
"""Two lots of unchanged drives: what baselines and the training's reference are made of, and what is held against."""
CHANGES = {
    FRESH: "unchanged, each window with a friction of its own",
    "ideal": "every car has exact sensors",
    "gyro 2 %": "every gyro reads 2 % too much",
    "gyro 5 %": "every gyro reads 5 % too much",
    "faster": "20 % faster: wish, and what drivers find comfortable",
    "other road": "the cars pass another road",
}


@dataclass(frozen=True, slots=True, eq=False)
class Drives:
    """Passages of one kind of traffic, by friction. All arrays (n,) but the rows.

    Attributes:
        rows: Features, those of the road too. (n, columns)
        mu: Estimates.
        strange: Whether each lies outside the envelope.
        friction_mu: Of the road.
        driven_count: Drives, those that gave no summary too.
    """

    rows: FloatArray
    mu: FloatArray
    strange: BoolArray
    friction_mu: FloatArray
    driven_count: int

    @property
    def kinematic(self) -> FloatArray:
        """Rows without the road's features."""
        return self.rows[:, : len(NEWEST_TABLE.kinematic)]


def driven_rows(kind: str, friction_mu: float, count: int) -> FloatArray:
    """Return the features of a kind of traffic at one friction; drives without a summary are left out. (m, columns)"""
    section = read_section(OTHER_SECTION if kind == "other road" else SECTION)
    road_map = surveyed_map(Terms("drift-alarms", SEED, SensorGrade.AUTOMOTIVE), section)
    grade = SensorGrade.IDEAL if kind == "ideal" else SensorGrade.AUTOMOTIVE
    rng = chance(SEED, f"{kind}|{friction_mu}")
    plans = [draw_plan(rng, section=section, base_friction_mu=friction_mu, grade=grade) for _ in range(count)]
    road, rows = road_features(section), []
    for drive in each_passage(section, (_faster(plan) if kind == "faster" else plan for plan in plans)):
        if not drive.completed:
            continue
        trace = replace(drive.trace, yaw_rate_radps=GYRO_RATIOS.get(kind, 1.0) * drive.trace.yaw_rate_radps)
        found = summarise_passage(trace, road_map, noise=DECLARED_NOISE[grade])
        if not isinstance(found, Rejected):
            rows.append(np.concatenate([np.array(found.summary.values), road]))
    return np.array(rows).reshape(-1, len(NEWEST_TABLE)).astype(np.float32).astype(np.float64)


def judged(bundle: Bundle, model: ModelManifest, parts: Sequence[FloatArray], *, count: int) -> Drives:
    """Return drives with what the bundle says of them; the parts are those of `FRICTIONS_MU`."""
    rows = np.concatenate(parts)
    if model.ordinary is None:
        raise SystemExit("the packaged bundle does not say what is ordinary")
    strange = is_strange_driving(rows, model.ordinary, model.feature_names)
    return Drives(
        rows=rows,
        mu=onnx_estimate_mu(bundle.files[model.model_file], rows),
        strange=strange | is_strange_road(rows, model.ordinary, model.feature_names),
        friction_mu=np.repeat(FRICTIONS_MU, [len(part) for part in parts]),
        driven_count=count * len(parts),
    )


def traffics(bundle: Bundle, model: ModelManifest, *, drives_count: int) -> dict[str, Drives]:
    """Return every kind of traffic, driven and judged; twice as many drives of the unchanged one."""
    counts = dict.fromkeys([LEARNED, *CHANGES], drives_count) | {FRESH: 2 * drives_count}
    with executor(cpu_count() or 1) as pool:
        work: dict[str, list[Future[FloatArray]]] = {
            kind: [pool.submit(driven_rows, kind, friction_mu, count) for friction_mu in FRICTIONS_MU]
            for kind, count in counts.items()
        }
        done = {}
        for kind, parts in work.items():
            done[kind] = judged(bundle, model, [part.result() for part in parts], count=counts[kind])
            print(f"driven: {kind}, {counts[kind]} at each of {len(FRICTIONS_MU)} frictions", file=sys.stderr)
    return done


def hour_of(drives: Drives, rng: np.random.Generator, *, count: int, frictions_mu: Sequence[float]) -> NDArray[np.intp]:
    """Return which drives pass in an hour of one friction; as many as there are if they do not suffice. (count,)"""
    there = np.flatnonzero(drives.friction_mu == rng.choice(frictions_mu))
    return rng.choice(there, min(count, len(there)), replace=False)


def bands_of(drives: Drives, rng: np.random.Generator, *, frictions_mu: Sequence[float]) -> tuple[BandReference, ...]:
    """Return what hours of such frictions teach of a section."""
    hours = [hour_of(drives, rng, count=HOURLY_COUNT, frictions_mu=frictions_mu) for _ in range(BASELINE_HOURS_COUNT)]
    left_at_s = np.repeat(
        np.linspace(0.0, 3600.0 * len(hours), len(hours), endpoint=False), [len(hour) for hour in hours]
    )
    places = np.concatenate(hours)
    counted = ~drives.strange[places]
    return learned_bands(
        left_at_s=left_at_s[counted], rows=drives.kinematic[places][counted], mu=drives.mu[places][counted]
    )


def outcome_of(
    known: Drives,
    drives: Drives,
    *,
    count: int,
    taught_mu: Sequence[float] = FRICTIONS_MU,
    frictions_mu: Sequence[float] = FRICTIONS_MU,
) -> list[str]:
    """Return the cells of a line for windows of one size.

    Args:
        known: What teaches the baseline and the training's reference.
        drives: What is held against them.
        count: Passages of a window.
        taught_mu: Frictions of the hours that teach.
        frictions_mu: Frictions of the windows.
    """
    rng, policy = np.random.default_rng(SEED), DriftPolicy()
    (reference,) = learn_references(known.rows, known.mu, [""] * len(known.mu), known_sections=[])
    names = [feature.name for feature in NEWEST_TABLE.kinematic]
    moved, own, outside, naive = [], [], [], []
    for _ in range(BASELINES_COUNT):
        bands = bands_of(known, rng, frictions_mu=taught_mu)
        for _ in range(TRIALS_COUNT):
            hour = hour_of(drives, rng, count=count, frictions_mu=frictions_mu)
            report = drift_report(
                reference,
                names,
                drives.kinematic[hour],
                drives.mu[hour],
                out_of_envelope_count=int(drives.strange[hour].sum()),
                total_count=len(hour),
                baseline=bands,
            )
            if report.own_features:
                moved.append(report.own_drifted_count / len(names))
            own.append(DriftAlarm.OWN_TRAFFIC in report.alarms)
            outside.append(DriftAlarm.OUT_OF_ENVELOPE in report.alarms)
            naive.append(report.drifted_count > policy.own_drifted_limit_frac * len(names))
    shares = (float(np.mean(own)), float(np.mean(outside)), float(np.mean(naive)))
    return [
        percent(float(np.median(moved)), digits=0) if moved else "not compared",
        *(percent(share) for share in shares),
    ]


HEAD = (
    "traffic",
    "passages",
    "no summary",
    "outside envelope",
    "features moved (median)",
    "alarm: own traffic",
    "alarm: envelope",
    "if the training decided",
)


def table_of(found: dict[str, Drives], windows_counts: Sequence[int]) -> str:
    """Return the table in Markdown."""
    known, fresh = found[LEARNED], found[FRESH]
    rows = []

    def line(words: str, drives: Drives, count: int, **frictions: Sequence[float]) -> None:
        refused = percent(1.0 - len(drives.mu) / drives.driven_count)
        cells = outcome_of(known, drives, count=count, **frictions)
        rows.append([words, str(count), refused, percent(float(drives.strange.mean())), *cells])

    for count in windows_counts:
        for kind, words in CHANGES.items():
            line(words, found[kind], count)
        line("unchanged, ice after 0.3 and more", fresh, count, taught_mu=FRICTIONS_MU[1:], frictions_mu=(0.2,))
        line("unchanged, rain after 0.6 and more", fresh, count, taught_mu=FRICTIONS_MU[4:], frictions_mu=(0.4,))
    return table(HEAD, rows)


def _faster(plan: PassagePlan) -> PassagePlan:
    """Return a plan of a driver in more of a hurry, who bears the sideways push that goes with it."""
    comfort_mps2 = SPEED_RATIO**2 * plan.driver.comfort_accel_mps2
    wish_mps = None if plan.target_speed_mps is None else SPEED_RATIO * plan.target_speed_mps
    return replace(plan, target_speed_mps=wish_mps, driver=plan.driver._replace(comfort_accel_mps2=comfort_mps2))


def main() -> None:
    """Drive, judge, print, and write the whole table into the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--drives", type=int, default=300, help="at each friction, of each kind of traffic")
    drives_count = parser.parse_args().drives
    bundle = read_bundle(Path(str(files("rsu_app") / "default_bundle")))
    model = bundle.manifest.model_for(NEWEST_TABLE.digest)
    if model is None:
        raise SystemExit("the packaged bundle does not serve the newest feature table")
    found = traffics(bundle, model, drives_count=drives_count)
    whole = drives_count >= max(WINDOWS_COUNTS) + 40  # some drives give no summary
    text = table_of(found, WINDOWS_COUNTS if whole else WINDOWS_COUNTS[:1])
    print(text)
    if whole:
        page = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(with_tables(page, {TABLE_NAME: text}.get), encoding="utf-8")


if __name__ == "__main__":
    main()
