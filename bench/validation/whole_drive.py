"""One whole drive through the S-turn, as the fleet and the laboratory see it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bench.validation.picture import OURS, QUIET, THEORY, THIRD, headroom, label, legend, line, panels, write
from roadgrip.sections import read_section
from roadgrip.units import GRAVITY_MPS2, FloatArray
from vehicle_client.simulator.drive import Drive
from vehicle_client.simulator.plan import SensorGrade, draw_plan
from vehicle_client.simulator.run import simulate_passage

BASE_FRICTION_MU = 0.35
SEED = 20
PEAK_RATIO = 0.85
"""The drawn drive uses at least this share of the grip somewhere, and ESC: an easy one shows little."""


def draw(folder: Path) -> dict[str, Any]:
    """Draw the picture of one drive and return what it was.

    Args:
        folder: Where pictures go.
    """
    section = read_section("s-turn")
    drive = _telling_drive()
    truth, trace = drive.truth, drive.trace
    figure, axes = panels(2, 3, title=f"S-turn at a base friction of {BASE_FRICTION_MU}, automotive sensors")
    station = truth.station_m
    path, speed, steer, slip, grip, friction = axes

    centre = section.profile
    line(path, centre.x_m, centre.y_m, QUIET, linewidth=3.5, alpha=0.35)
    line(path, truth.x_m, truth.y_m, OURS)
    path.set_aspect("equal", adjustable="datalim")
    label(path, "Path over the section (grey)", x="east, m", y="north, m")

    _line(speed, station, truth.velocity_x_mps, OURS)
    wheel = trace.wheel_speed_mps
    _line(speed, station, wheel[:, 0], THIRD, linewidth=0.7)
    label(speed, "Speed", x="station, m", y="m/s")
    legend(speed, ("car", OURS), ("front left wheel, measured", THIRD))
    headroom(speed)

    _line(steer, station, np.degrees(trace.yaw_rate_radps), THIRD, linewidth=0.7)
    _line(steer, station, np.degrees(truth.yaw_rate_radps), OURS)
    _line(steer, station, np.degrees(truth.steer_rad), THEORY)
    label(steer, "Steering and yaw rate", x="station, m", y="° and °/s")
    legend(steer, ("yaw rate", OURS), ("measured", THIRD), ("angle of the front wheels", THEORY))
    headroom(steer)

    _line(slip, station, np.degrees(truth.sideslip_rad), OURS)
    _line(slip, station, np.degrees(truth.roll_rad), THEORY)
    label(slip, "Sideslip and roll", x="station, m", y="°")
    legend(slip, ("sideslip", OURS), ("roll", THEORY))
    headroom(slip)

    _line(grip, station, truth.accel_y_mps2 / GRAVITY_MPS2, OURS)
    _line(grip, station, truth.accel_x_mps2 / GRAVITY_MPS2, THEORY)
    label(grip, "Acceleration over g", x="station, m", y="g")
    legend(grip, ("lateral", OURS), ("longitudinal", THEORY))
    headroom(grip)

    _line(friction, station, truth.utilisation_ratio, OURS)
    for active, colour, at in ((truth.esc_active, THEORY, 1.06), (truth.abs_active, THIRD, 1.10)):
        friction.plot(station[active], np.full(int(active.sum()), at), "|", color=colour, ms=5)
    friction.set_ylim(0.0, 1.25)
    label(friction, "Share of the grip in use", x="station, m", y="force / (mu load)")
    legend(friction, ("ESC active", THEORY), ("ABS active", THIRD))
    headroom(friction)
    return {
        "label_mu": drive.label_mu,
        "peak_utilisation_ratio": drive.peak_utilisation_ratio,
        "peak_sideslip_rad": drive.peak_sideslip_rad,
        "esc_active_frac": drive.esc_active_frac,
        "picture": write(figure, folder, "whole_drive"),
    }


def _line(axes: Any, x: FloatArray, y: FloatArray, colour: str, **style: Any) -> None:
    """Draw a curve that trembles with the road; every fifth sample shows as much of that as a picture can."""
    line(axes, x[::5], y[::5], colour, tolerance_ratio=3e-3, **style)


def _telling_drive() -> Drive:
    section = read_section("s-turn")
    rng = np.random.default_rng(SEED)
    for _ in range(400):
        plan = draw_plan(rng, section=section, base_friction_mu=BASE_FRICTION_MU, grade=SensorGrade.AUTOMOTIVE)
        drive = simulate_passage(section, plan)
        if drive.completed and drive.peak_utilisation_ratio >= PEAK_RATIO and drive.esc_active_frac > 0.0:
            return drive
    raise RuntimeError("nobody came through the S-turn with the help of ESC")
