"""The paper's picture of its observer, S-turn at a friction of 0.2 and 72 km/h, redrawn with the truth beside it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.onboard.agreement import agreement, pooled
from bench.onboard.chapters import Figures
from bench.onboard.drives import GRADES, SEED
from bench.validation.picture import OURS, QUIET, THEORY, THIRD, headroom, label, legend, line, panels, write
from roadgrip.records import Rejected
from roadgrip.section import RoadSection
from roadgrip.sections import read_section
from roadgrip.units import GRAVITY_MPS2, FloatArray, kph_to_mps, mps_to_kph
from training.chance import chance
from training.marked_tables import table
from vehicle_client.estimation.observer import PAPER_PARAMETERS, XC90_PARAMETERS, ObserverParameters
from vehicle_client.estimation.offsets import NO_OFFSETS
from vehicle_client.estimation.signals import kinematic_signals
from vehicle_client.estimation.summary import KinematicSignals
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.pipeline import summarise_passage
from vehicle_client.simulator.amplitudes import SENSORS
from vehicle_client.simulator.drive import Drive
from vehicle_client.simulator.map_error import map_as_surveyed
from vehicle_client.simulator.plan import Driver, PassagePlan, SensorGrade, draw_plan
from vehicle_client.simulator.run import each_passage, simulate_passage

BASE_FRICTION_MU = 0.2
SPEED_MPS = kph_to_mps(72.0)
HELD_MPS = kph_to_mps(45.0)
DRAWN_COUNT = 200
TRUTH_COLOUR = "#222222"
_WORDS = {
    "held_at_72_kph": "72 km/h held",
    "held_at_45_kph": "45 km/h held",
    "slowing_in_time": "72 km/h wanted, surface judged right",
    "slowing_too_late": "72 km/h wanted, surface misjudged",
}
COLOURS = {SensorGrade.AUTOMOTIVE: OURS, SensorGrade.IDEAL: THIRD}


def draw(folder: Path) -> dict[str, Any]:
    """Draw four drives, estimate and truth; return what they were and how well the estimate did.

    Args:
        folder: Where pictures go.
    """
    section = read_section("s-turn")
    profile = section.profile
    plans = {
        "held_at_72_kph": _unimpressed(SPEED_MPS),
        "held_at_45_kph": _unimpressed(HELD_MPS),
        "slowing_in_time": _judging(SPEED_MPS),
        "slowing_too_late": _sliding(section),
    }
    figure, axes = panels(2, 2, title=f"Sideslip, S-turn at a friction of {BASE_FRICTION_MU}: estimate and truth")
    figures: dict[str, Any] = {
        "seed": SEED,
        "base_friction_mu": BASE_FRICTION_MU,
        # Friction plus bank against the centripetal acceleration, at the place where that allows the least.
        "fastest_possible_mps": float(
            np.sqrt(
                np.min(
                    GRAVITY_MPS2
                    * (BASE_FRICTION_MU + np.abs(profile.cross_slope_ratio))
                    / np.maximum(np.abs(profile.curvature_1pm), 1e-6)
                )
            )
        ),
        "drives": {},
    }
    for panel, (name, plan) in zip(axes, plans.items(), strict=True):
        figures["drives"][name] = _draw_drive(panel, section, plan, words=_WORDS[name])
    legend(
        axes[1],
        ("truth", TRUTH_COLOUR),
        ("estimate, automotive sensors", OURS),
        ("estimate, ideal sensors", THIRD),
        ("F pulling to zero as in the paper, automotive", THEORY),
        top=0.97,
    )
    figures["picture"] = write(figure, folder, "paper_figure")
    return figures


def _unimpressed(speed_mps: float) -> PassagePlan:
    """Return a driver whom neither the look of the surface nor the bends slow down."""
    driver = Driver(comfort_accel_mps2=20.0, grip_share_ratio=5.0, slide_feeling_ratio=100.0)
    return PassagePlan(BASE_FRICTION_MU, seed=SEED, target_speed_mps=speed_mps, driver=driver)


def _judging(speed_mps: float) -> PassagePlan:
    driver = Driver(friction_guess_mu=BASE_FRICTION_MU)
    return PassagePlan(BASE_FRICTION_MU, seed=SEED, target_speed_mps=speed_mps, driver=driver)


def _sliding(section: RoadSection) -> PassagePlan:
    """Return the drawn drive whose rear tyres slip the most of those that stay on the road."""
    rng = chance(SEED, "paper_figure")
    plans = [
        replace(draw_plan(rng, section=section, base_friction_mu=BASE_FRICTION_MU), target_speed_mps=SPEED_MPS)
        for _ in range(DRAWN_COUNT)
    ]
    slips = [_rear_slip_rad(drive) if drive.completed else 0.0 for drive in each_passage(section, plans)]
    return plans[int(np.argmax(slips))]


def _rear_slip_rad(drive: Drive) -> float:
    """Return the largest angle between where the rear wheels point and where they go."""
    truth = drive.truth
    rear_y_mps = truth.velocity_y_mps - XC90.rear_axle_m * truth.yaw_rate_radps
    return float(np.abs(np.arctan2(rear_y_mps, truth.velocity_x_mps)).max())


def _draw_drive(panel: Any, section: RoadSection, plan: PassagePlan, *, words: str) -> dict[str, Any]:
    figures: dict[str, Any] = {}
    for grade in GRADES:
        road_map = map_as_surveyed(section, rng=chance(SEED, "paper_figure map"), sensors=SENSORS[grade])
        drive = simulate_passage(section, replace(plan, sensor_grade=grade))
        truth = drive.truth
        estimate = _signals(drive, road_map, XC90_PARAMETERS).sideslip_rad
        inside = (truth.station_m >= 0.0) & (truth.station_m <= section.length_m)
        since_s = truth.time_s - truth.time_s[inside][0]
        if grade is GRADES[0]:
            _line(panel, since_s[inside], truth.sideslip_rad[inside], TRUTH_COLOUR, linewidth=2.2)
            pulled = _signals(drive, road_map, PAPER_PARAMETERS).sideslip_rad
            _line(panel, since_s[inside], pulled[inside], THEORY, linewidth=1.2)
            figures |= {
                "outcome": drive.outcome.value,
                "reached_m": float(truth.station_m[-1]),
                "slowest_mps": float(truth.velocity_x_mps[inside].min()),
                "fastest_mps": float(truth.velocity_x_mps[inside].max()),
                "pull_to_zero": _figures(pulled[inside], truth.sideslip_rad[inside]),
            }
        _line(panel, since_s[inside], estimate[inside], COLOURS[grade])
        figures[grade.value] = _figures(estimate[inside], truth.sideslip_rad[inside])
    gone = "" if figures["outcome"] == "completed" else ": leaves the road"
    panel.axhline(0.0, color=QUIET, linewidth=0.8)
    label(panel, f"{words}{gone}", x="since the start of the section, s", y="sideslip, °")
    headroom(panel, 0.35)
    return figures


def _figures(estimate_rad: FloatArray, truth_rad: FloatArray) -> dict[str, float | int]:
    found = pooled([agreement(estimate_rad, truth_rad)], unit="rad")
    return {key: found[key] for key in ("rms_error_rad", "rms_truth_rad", "correlation_ratio", "peak_truth_q50_rad")}


def _signals(drive: Drive, road_map: RoadSection, parameters: ObserverParameters) -> KinematicSignals:
    """Return the signals; of a drive that the client refuses, with the true position and no offsets."""
    result = summarise_passage(drive.trace, road_map, parameters=parameters)
    if not isinstance(result, Rejected):
        return result.signals
    return kinematic_signals(
        drive.trace,
        road_map,
        station_m=drive.truth.station_m,
        vehicle=XC90,
        parameters=parameters,
        offsets=NO_OFFSETS,
    )


def _line(axes: Any, x: FloatArray, y_rad: FloatArray, colour: str, **style: Any) -> None:
    line(axes, x[::3], np.degrees(y_rad[::3]), colour, tolerance_ratio=2e-3, **style)


def _drives_table(figures: Figures) -> str:
    rows = []
    for name, words in _WORDS.items():
        found = figures["drives"][name]
        end = "to the end" if found["outcome"] == "completed" else f"leaves the road at {found['reached_m']:.0f} m"
        rows.append(
            [
                words,
                f"{mps_to_kph(found['slowest_mps']):.0f} to {mps_to_kph(found['fastest_mps']):.0f}",
                end,
                *(f"{np.degrees(found[key]['rms_error_rad']):.2f}" for key in ("automotive", "ideal", "pull_to_zero")),
                f"{np.degrees(found['ideal']['rms_truth_rad']):.2f}",
                f"{found['automotive']['correlation_ratio']:.2f}",
            ]
        )
    head = (
        "drive",
        "km/h",
        "goes",
        "error, °: automotive",
        "ideal sensors",
        "F pulling to zero",
        "none, °",
        "correlation",
    )
    return table(head, rows)


TABLES = {"drives": _drives_table}
