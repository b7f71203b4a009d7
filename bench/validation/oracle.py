"""Our car beside somebody else's multi-body car: the curves, and what explains their differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.simulator_oracle import (
    OracleCar,
    Variant,
    comparable_car,
    drive_oracle,
    fitted_tyre,
    oracle_parameters,
    oracle_tyre_force_n,
    our_tyre_force_n,
)
from bench.validation.picture import OURS, QUIET, THEORY, THIRD, label, line, name, panels, write
from bench.validation.side_by_side import (
    LOW_MU,
    STEP_ACCELS_MPS2,
    Pair,
    all_figures,
    braking,
    drive_both,
    lane_change,
    over_ratio,
    step_figures,
    step_steer,
    widening_circle,
)

SHOWN = OracleCar.BMW_320I
DEGREES = 180.0 / np.pi
STIFFER = 30.0


def draw(folder: Path, said: Callable[[str], None] = lambda _: None) -> dict[str, Any]:
    """Draw the picture of the oracle and return how far apart the cars are.

    Args:
        folder: Where pictures go.
        said: Is told how far it has come.
    """
    figure, axes = panels(3, 3, title=f"Ours (blue) beside the CommonRoad multi-body model (orange), {SHOWN.value}")
    parameters = oracle_parameters(SHOWN)
    vehicle = comparable_car(parameters)

    def pairs(manoeuvre: Any) -> tuple[Pair, Pair]:
        return (
            drive_both(manoeuvre, SHOWN, Variant.PUBLISHED, vehicle=vehicle),
            drive_both(manoeuvre, SHOWN, Variant.PLAIN, vehicle=vehicle),
        )

    _tyre(axes[0])
    said("step steer")
    for accel in STEP_ACCELS_MPS2:
        both = pairs(step_steer(parameters, accel_mps2=accel))
        for panel, signal, unit in (
            (axes[1], "yaw_rate_radps", DEGREES),
            (axes[2], "accel_y_mps2", 1.0),
            (axes[3], "roll_rad", DEGREES),
        ):
            _curves(panel, both, signal, unit)
    label(axes[1], "Step steer: yaw rate", x="time, s", y="°/s")
    label(axes[2], "Step steer: lateral acceleration", x="time, s", y="m/s²")
    label(axes[3], "Step steer: roll", x="time, s", y="°")
    axes[1].text(0.40, 0.10, "orange: as published\ngreen: plain (see text)",
                 color=QUIET, fontsize=8, transform=axes[1].transAxes)  # fmt: skip
    said("circle")
    for pair, colour in zip(pairs(widening_circle(parameters)), (THEORY, THIRD), strict=True):
        for course, shade in ((pair.theirs, colour), (pair.ours, OURS)):
            until = int(np.argmax(course.accel_y_mps2)) + 1
            line(axes[4], course.accel_y_mps2[:until], np.degrees(course.steer_rad[:until]), shade)
    axes[4].set_ylim(0.0, 5.0)
    label(axes[4], "Widening circle at 20 m/s", x="lateral acceleration, m/s²", y="steering angle, °")
    said("lane changes")
    _curves(axes[5], pairs(lane_change(parameters, accel_mps2=5.0, back=True)), "yaw_rate_radps", DEGREES)
    label(axes[5], "Double lane change: yaw rate", x="time, s", y="°/s")
    low = lane_change(parameters, accel_mps2=2.5, back=True, friction_mu=LOW_MU)
    both = pairs(low)
    _curves(axes[6], both, "yaw_rate_radps", DEGREES)
    label(axes[6], f"The same at mu {LOW_MU}", x="time, s", y="°/s")
    _curves(axes[7], both, "sideslip_rad", DEGREES)
    label(axes[7], f"The same at mu {LOW_MU}: sideslip", x="time, s", y="°")
    said("braking")
    _curves(axes[8], pairs(braking(decel_mps2=7.0)), "velocity_x_mps", 1.0, until_s=4.2)
    label(axes[8], "Braking by 7 m/s²", x="time, s", y="m/s")
    figures: dict[str, Any] = {
        "tyre_fit_largest_error_over_peak_ratio": _fit_error(),
        "stiffer_joints_largest_change_ratio": _joints(),
    }
    for car in OracleCar:
        for variant in Variant:
            said(f"{car.value} {variant.value}")
            found = dict(all_figures(car, variant))
            figures.setdefault(car.name.lower(), {})[variant.name.lower()] = found
    return figures | {"picture": write(figure, folder, "oracle")}


def _curves(axes: Any, both: tuple[Pair, Pair], signal: str, unit: float, *, until_s: float = float("inf")) -> None:
    """Draw a signal of both cars; the oracle of a car that stands still means nothing, hence the end."""
    published, plain = both
    for course, colour, width in (
        (published.theirs, THEORY, 2.6),
        (plain.theirs, THIRD, 1.6),
        (published.ours, OURS, 1.0),
    ):
        shown = course.time_s <= until_s
        values = unit * getattr(course, signal)[shown]
        line(axes, course.time_s[shown], values, colour, linewidth=width, tolerance_ratio=2e-3)


def _tyre(axes: Any) -> None:
    parameters = oracle_parameters(SHOWN, Variant.NO_CAMBER)
    tyre = fitted_tyre(oracle_parameters(SHOWN))
    slip = np.linspace(0.0, 0.6, 150)
    for axis, peak, word, up in (
        ("x", parameters.tire.p_dx1, "longitudinal", 5),
        ("y", parameters.tire.p_dy1, "lateral", -12),
    ):
        theirs = [oracle_tyre_force_n(parameters, axis, slip=float(s), load_n=3e3) / 3e3 for s in slip]
        ours = [our_tyre_force_n(tyre, axis, slip=float(s), load_n=3e3, friction_mu=peak) / 3e3 for s in slip]
        line(axes, slip, np.array(theirs), THEORY, linewidth=2.6)
        line(axes, slip, np.array(ours), OURS, linewidth=1.0)
        name(axes, 0.4, ours[100], word, QUIET, xytext=(0, up))
    label(axes, "Tyre: Pacejka, and TMeasy fitted to it", x="slip", y="force / load")


def _fit_error() -> dict[str, float]:
    parameters = oracle_parameters(SHOWN, Variant.NO_CAMBER)
    tyre = fitted_tyre(oracle_parameters(SHOWN))
    errors = {}
    for axis, peak in (("x", parameters.tire.p_dx1), ("y", parameters.tire.p_dy1)):
        errors[axis] = max(
            abs(
                our_tyre_force_n(tyre, axis, slip=float(s), load_n=3e3, friction_mu=peak)
                - oracle_tyre_force_n(parameters, axis, slip=float(s), load_n=3e3)
            )
            / (3e3 * peak)
            for s in np.linspace(0.0, 0.6, 200)
        )
    return errors


def _joints() -> float:
    """Return what the oracle's joints between body and axles change at most in a step response."""
    parameters = oracle_parameters(SHOWN, Variant.PLAIN)
    stiff = replace(parameters, K_ras=STIFFER * parameters.K_ras, K_rad=STIFFER**0.5 * parameters.K_rad)
    manoeuvre = step_steer(parameters, accel_mps2=4.0)
    soft, hard = (step_figures(drive_oracle(manoeuvre, p)) for p in (parameters, stiff))
    return max(abs(over_ratio(soft[k], hard[k])) for k in soft if k != "overshoot_ratio")
