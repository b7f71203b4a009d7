"""The virtual sensor against the truth, in the paper's design: sideslip first, and what else is estimated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.onboard.agreement import Agreement, agreement, gain_by_frequency, pooled
from bench.onboard.drives import GRADES, SEED, Watched, completed_drives, study_scenarios
from bench.onboard.sideslip_view import TABLES, draw_errors, draw_gain
from bench.onboard.variants import VARIANTS, Variant, varied_signals
from roadgrip.records import Rejected
from roadgrip.units import FloatArray
from training.designs import BASE_FRICTIONS_MU
from training.scenarios import Scenario
from vehicle_client.estimation.filters import rate_of_change, smoothed
from vehicle_client.estimation.summary import KinematicSignals
from vehicle_client.estimation.yaw_rate import yaw_rate_excess_radps
from vehicle_client.simulator.plan import SensorGrade

__all__ = ["TABLES", "draw", "signals_and_truth"]

DRIVES_COUNT = 40
"""Per cell: scenario, base friction, grade of sensors."""
OTHER_CARS_FRICTIONS_MU = (0.2, 0.45, 0.7)
EDGES_HZ = (0.03, 0.06, 0.1, 0.15, 0.22, 0.33, 0.5, 0.75, 1.1, 1.7, 2.5, 4.0, 6.0)
_OF_VARIANTS = ("rms_error_rad", "rms_error_standard_error_rad", "correlation_ratio", "seen_of_peak_q50_ratio")
Curves = dict[str, tuple[FloatArray, FloatArray]]


@dataclass
class _Gathered:
    """What is gathered of drives, in the order in which they were driven."""

    by_signal: dict[str, list[Agreement]] = field(default_factory=dict)
    by_variant: dict[str, list[Agreement]] = field(default_factory=dict)
    refused_count: int = 0
    traces: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)

    def __add__(self, other: _Gathered) -> _Gathered:
        return _Gathered(
            _joined(self.by_signal, other.by_signal),
            _joined(self.by_variant, other.by_variant),
            self.refused_count + other.refused_count,
            self.traces + other.traces,
        )


def _joined(one: dict[str, list[Agreement]], other: dict[str, list[Agreement]]) -> dict[str, list[Agreement]]:
    return {name: one.get(name, []) + other.get(name, []) for name in {**one, **other}}


def draw(folder: Path) -> dict[str, Any]:
    """Draw sideslip errors over friction and the gain over frequency; return all figures.

    Args:
        folder: Where pictures go.
    """
    figures: dict[str, Any] = {"seed": SEED, "drives_per_cell_count": DRIVES_COUNT, "grades": {}}
    for grade in GRADES:
        scenarios = {}
        for scenario in study_scenarios():
            print(f"    sideslip: {grade}, {scenario.name}", flush=True)
            scenarios[scenario.name] = _scenario_figures(scenario, grade)
        figures["grades"][grade.value] = scenarios
    print("    sideslip: other cars", flush=True)
    figures["other_cars"] = {
        scenario.name: _other_cars_figures(scenario) for scenario in study_scenarios(varied_vehicles=True)
    }
    figures["picture"] = draw_errors(figures["grades"], folder)
    figures["gain_picture"] = draw_gain(figures["grades"], folder)
    return figures


def _scenario_figures(scenario: Scenario, grade: SensorGrade) -> dict[str, Any]:
    cells = {mu: _cell(scenario, grade, mu, VARIANTS) for mu in BASE_FRICTIONS_MU}
    whole = sum(cells.values(), _Gathered())
    return {
        "cells": [
            {
                "base_friction_mu": mu,
                **pooled(cell.by_signal["sideslip_rad"], unit="rad"),
                "variants_rms_error_rad": {
                    name: pooled(drives, unit="rad")["rms_error_rad"] for name, drives in cell.by_variant.items()
                },
            }
            for mu, cell in cells.items()
            if cell.by_signal
        ],
        "refused_count": whole.refused_count,
        "all_frictions": {
            name.rpartition("_")[0]: pooled(drives, unit=name.rpartition("_")[2])
            for name, drives in whole.by_signal.items()
        },
        "variants": {
            name: {key: found[key] for key in _OF_VARIANTS}
            for name, drives in whole.by_variant.items()
            for found in [pooled(drives, unit="rad")]
        },
        "edges_hz": list(EDGES_HZ),
        **gain_by_frequency(whole.traces, edges_hz=EDGES_HZ),
    }


def _other_cars_figures(scenario: Scenario) -> dict[str, Any]:
    """Return how well cars are served that know their own measures, but have the constants of the paper's car."""
    variants = {name: VARIANTS[name] for name in ("pull_to_zero",)}
    cells = [_cell(scenario, SensorGrade.AUTOMOTIVE, mu, variants) for mu in OTHER_CARS_FRICTIONS_MU]
    whole = sum(cells, _Gathered())
    return {"as_it_is": pooled(whole.by_signal["sideslip_rad"], unit="rad")} | {
        name: pooled(drives, unit="rad") for name, drives in whole.by_variant.items()
    }


def _cell(
    scenario: Scenario, grade: SensorGrade, base_friction_mu: float, variants: Mapping[str, Variant]
) -> _Gathered:
    cell = _Gathered()
    for watched in completed_drives(scenario, grade, base_friction_mu=base_friction_mu, drives_count=DRIVES_COUNT):
        if isinstance(watched.result, Rejected):
            cell.refused_count += 1
            continue
        station = watched.drive.truth.station_m
        inside = (station >= 0.0) & (station <= scenario.section.length_m)
        for name, (estimate, truth) in signals_and_truth(watched, watched.result.signals).items():
            cell.by_signal.setdefault(name, []).append(agreement(estimate[inside], truth[inside]))
        truth = watched.drive.truth.sideslip_rad
        cell.traces.append((watched.result.signals.sideslip_rad, truth))
        for name, variant in variants.items():
            estimate = varied_signals(watched, watched.result, variant, section=scenario.section).sideslip_rad
            cell.by_variant.setdefault(name, []).append(agreement(estimate[inside], truth[inside]))
    return cell


def signals_and_truth(watched: Watched, signals: KinematicSignals) -> Curves:
    """Return estimate and truth of all that is compared, by name and unit.

    The truth of the sideslip rate is the derivative of the true sideslip, smoothed as the estimate is; the truth of
    the yaw rate excess is the formula with true speed, steering and yaw rate.
    """
    truth, car = watched.drive.truth, watched.run.geometry
    return {
        "sideslip_rad": (signals.sideslip_rad, truth.sideslip_rad),
        "sideslip_rate_radps": (signals.sideslip_rate_radps, smoothed(rate_of_change(truth.sideslip_rad))),
        "yaw_rate_excess_radps": (
            signals.yaw_rate_excess_radps,
            yaw_rate_excess_radps(
                truth.yaw_rate_radps,
                truth.velocity_x_mps,
                truth.steer_rad,
                wheelbase_m=car.wheelbase_m,
                track_m=car.track_m,
            ),
        ),
        "speed_mps": (signals.speed_mps, truth.velocity_x_mps),
        "velocity_y_mps": (signals.velocity_y_mps, truth.velocity_y_mps),
        "chassis_roll_rad": (signals.chassis_roll_rad, truth.roll_rad),
    }
