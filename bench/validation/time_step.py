"""What half and a quarter of the time step change: in the motion of whole drives, and in the summaries a model sees."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bench.validation.picture import OURS, QUIET, SERIES, THEORY, label, name, panels, write
from roadgrip.features import PAPER_TABLE, summary_for
from roadgrip.section import RoadSection
from roadgrip.sections import read_section
from roadgrip.units import FloatArray
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.simulator.drive import Drive
from vehicle_client.simulator.journey import STEP_S
from vehicle_client.simulator.plan import SensorGrade, draw_plan
from vehicle_client.simulator.run import simulate_passage

ROADS = ("long-turn", "s-turn", "sharp-turn")
FRICTIONS_MU = (0.25, 0.35, 0.5, 0.7)
RUNS_COUNT = 15
"""Per road and friction."""
FINEST_S = 0.0005
SEED = 5
SIGNALS = ("steer_rad", "sideslip_rad", "yaw_rate_radps", "velocity_x_mps", "accel_y_mps2")


def draw(folder: Path) -> dict[str, Any]:
    """Draw the picture of the time step and return its figures.

    Args:
        folder: Where pictures go.
    """
    steps_s = (STEP_S, 0.5 * STEP_S)
    motion: dict[float, list[FloatArray]] = {step: [] for step in steps_s}
    values: dict[float, list[FloatArray]] = {step: [] for step in steps_s}
    spread: list[FloatArray] = []
    completed_count = changed_count = 0
    for road in ROADS:
        section = read_section(road)
        rng = np.random.default_rng(SEED)
        rows = []
        for k in range(RUNS_COUNT * len(FRICTIONS_MU)):
            mu = FRICTIONS_MU[k % len(FRICTIONS_MU)]
            # With positions, so that the matching is no part of what differs.
            plan = draw_plan(rng, section=section, base_friction_mu=mu, grade=SensorGrade.IDEAL, with_gnss=True)
            finest = simulate_passage(section, plan, step_s=FINEST_S)
            others = {step: simulate_passage(section, plan, step_s=step) for step in steps_s}
            changed_count += any(other.outcome is not finest.outcome for other in others.values())
            if not finest.completed or not all(other.completed for other in others.values()):
                continue
            completed_count += 1
            known, known_values = _statistics(finest, section), _features(finest, section)
            for step, other in others.items():
                motion[step].append(np.abs(_statistics(other, section) - known) / _scale(finest, section))
                values[step].append(np.abs(_features(other, section) - known_values))
            rows.append(known_values)
        spread += [np.std(rows, axis=0)] * len(rows)
    scale = np.array(spread)
    relative = {step: np.array(values[step]) / np.where(scale > 0.0, scale, 1.0) for step in steps_s}
    figure, axes = panels(1, 2, title="Time step")
    figures: dict[str, Any] = {
        "drives": completed_count,
        "drives_that_end_otherwise": changed_count,
        "finest_step_s": FINEST_S,
    }
    for panel, what, found in (
        (axes[0], "motion_statistics_over_largest_magnitude", {s: np.array(motion[s]) for s in steps_s}),
        (axes[1], "summary_values_over_their_spread", relative),
    ):
        figures[what] = {}
        for step, colour, word in ((steps_s[0], OURS, "the step in use"), (steps_s[1], SERIES[2], "half of it")):
            change = np.sort(np.maximum(found[step].ravel(), 1e-7))
            share = np.linspace(0.0, 100.0, len(change))
            thinned = np.unique(np.linspace(0, len(change) - 1, 150).astype(int))
            panel.plot(100.0 * change[thinned], share[thinned], color=colour)
            at = 30 if step == steps_s[0] else 70
            x = float(np.interp(at, share, change)) * 100.0
            name(panel, x, at, f"{1e3 * step:g} ms, {word}", colour, xytext=(6, -6))
            figures[what][f"step_{1e3 * step:g}_ms"] = {
                f"q{q:g}_ratio": float(np.quantile(found[step], q / 100.0)) for q in (50, 95, 99, 99.9)
            } | {"largest_ratio": float(found[step].max())}
        panel.axvline(1.0, color=THEORY, linestyle="--", linewidth=1.0)
        panel.set_xscale("log")
        panel.set_xlim(1e-4, 100.0)
    label(
        axes[0],
        "Statistics of the motion",
        x="change over the signal's largest magnitude, %",
        y="share of statistics, %",
    )
    label(axes[1], "Summary values", x="change over their spread between drives, %", y="share of values, %")
    axes[0].text(0.03, 0.93, f"{completed_count} drives, against {1e3 * FINEST_S:g} ms", color=QUIET, fontsize=8,
                 transform=axes[0].transAxes)  # fmt: skip
    return figures | {"picture": write(figure, folder, "time_step")}


def _inside(drive: Drive, section: RoadSection) -> Any:
    station = drive.truth.station_m
    return (station >= 0.0) & (station <= section.length_m)


def _statistics(drive: Drive, section: RoadSection) -> FloatArray:
    """Return mean, spread, quantiles and extremes of each signal inside the section. (signals, 7)"""
    inside = _inside(drive, section)
    rows = []
    for signal in SIGNALS:
        values = getattr(drive.truth, signal)[inside]
        rows.append([values.mean(), values.std(), *np.quantile(values, (0.0, 0.2, 0.5, 0.8, 1.0))])
    return np.array(rows)


def _scale(drive: Drive, section: RoadSection) -> FloatArray:
    inside = _inside(drive, section)
    return np.array([[np.abs(getattr(drive.truth, signal)[inside]).max()] for signal in SIGNALS])


def _features(drive: Drive, section: RoadSection) -> FloatArray:
    result = summarise_passage(drive.trace, section)
    if not isinstance(result, Summarised):
        raise RuntimeError(f"a completed drive was refused: {result}")  # noqa: TRY004 - a refusal is a value
    return np.array(summary_for(result.summary, PAPER_TABLE).values)
