"""What the car can do at most: cornering, braking and driving over friction; what ABS and ESC make of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.validation.picture import OURS, QUIET, THEORY, THIRD, label, legend, line, name, panels, write
from roadgrip.sections import read_section
from roadgrip.units import GRAVITY_MPS2, SAMPLE_S, FloatArray
from vehicle_client.simulator.plan import NO_SYSTEMS, DriverKind, StabilitySystems, draw_plan
from vehicle_client.simulator.proving_ground import Motion, Plane, drive_open_loop
from vehicle_client.simulator.run import simulate_passages
from vehicle_client.simulator.vehicle import XC90, Vehicle

FRICTIONS_MU = (0.1, 0.2, 0.35, 0.45, 0.6, 0.8, 1.0)
BANKS_RATIO = (0.0, 0.08)
ONLY_ABS = StabilitySystems(abs_on=True, tcs_on=False, esc_on=False)
ONLY_ESC = StabilitySystems(abs_on=False, tcs_on=False, esc_on=True)
STOP_FROM_MPS, STOP_TO_MPS = 25.0, 2.0
DWELL_FRICTION_MU = 0.35
ROAD_FRICTIONS_MU = (0.2, 0.25, 0.35, 0.45, 0.6)
RUNS_COUNT = 120
SEED = 11


def draw(folder: Path) -> dict[str, Any]:
    """Draw the pictures of the limits and return their figures.

    Args:
        folder: Where pictures go.
    """
    figure, axes = panels(2, 3, title="Limits")
    figures = {
        "lateral": _lateral(axes[0]),
        "longitudinal": _longitudinal(axes[1]),
        "abs": _stops(axes[2], axes[3]),
        "sine_with_dwell": _dwell(axes[4]),
        "on_the_road": _on_the_road(axes[5]),
    }
    return figures | {"picture": write(figure, folder, "limits")}


def peak_ratio(axis: str, load_n: float) -> float:
    """Return the peak force of a tyre over its load, over mu.

    Args:
        axis: `x` or `y`.
        load_n: Of the wheel.
    """
    one, two = (getattr(XC90.tyre, f"peak_{axis}{k}_ratio") for k in (1, 2))
    return float(1.0 + (two / one - 1.0) * (load_n / XC90.tyre.nominal_load_n - 1.0))


def lateral_limit_mps2(mu: float, *, normal_mps2: float) -> float:
    """Return the specific side force at which the first axle has no more to give, its tyres at the loads they bear.

    Args:
        mu: Friction.
        normal_mps2: Sum of the wheel loads over the mass.
    """
    car = XC90
    roll_axis = (
        car.front_roll_centre_m * car.rear_axle_m + car.rear_roll_centre_m * car.front_axle_m
    ) / car.wheelbase_m
    arm = car.cog_height_m - roll_axis

    def spare_n(force: float) -> float:
        roll = car.mass_kg * arm * force / (car.roll_stiffness_nmprad - car.mass_kg * GRAVITY_MPS2 * arm)
        spares = []
        for share, lever, centre, track in (
            (car.front_roll_stiffness_frac, car.rear_axle_m, car.front_roll_centre_m, car.front_track_m),
            (1.0 - car.front_roll_stiffness_frac, car.front_axle_m, car.rear_roll_centre_m, car.rear_track_m),
        ):
            mass = car.mass_kg * lever / car.wheelbase_m
            shift = (share * car.roll_stiffness_nmprad * roll + mass * force * centre) / track
            loads = [max(0.0, 0.5 * mass * normal_mps2 + side * shift) for side in (-1.0, 1.0)]
            spares.append(sum(mu * load * peak_ratio("y", load) for load in loads) - mass * force)
        return min(spares)

    return _zero(spare_n, 1.5 * mu * normal_mps2)


def _zero(falling: Callable[[float], float], high: float) -> float:
    low = 0.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if falling(middle) > 0.0 else (low, middle)
    return low


def longitudinal_limit(mu: float, *, sign: float) -> tuple[float, float]:
    """Return the largest braking or driving force of the tyres over the mass, and the front axle's share in it.

    Every tyre is at its peak, at the load it bears.

    Args:
        mu: Friction.
        sign: Of the acceleration.
    """
    car = XC90

    def grip_n(force: float) -> tuple[float, float]:
        shift = sign * car.mass_kg * car.cog_height_m * force / car.wheelbase_m
        front = car.mass_kg * GRAVITY_MPS2 * car.rear_axle_m / car.wheelbase_m - shift
        rear = car.mass_kg * GRAVITY_MPS2 - front
        return mu * front * peak_ratio("x", 0.5 * front), mu * rear * peak_ratio("x", 0.5 * rear)

    force = _zero(lambda f: sum(grip_n(f)) - car.mass_kg * f, 1.5 * mu * GRAVITY_MPS2)
    front, rear = grip_n(force)
    return force, front / (front + rear)


def _moving_mean(values: FloatArray, seconds: float) -> FloatArray:
    width = round(seconds / SAMPLE_S)
    mean: FloatArray = np.convolve(values, np.full(width, 1.0 / width), mode="valid")
    return mean


def _lateral(axes: Any) -> list[dict[str, float]]:
    rows: list[dict[str, float]] = []
    for bank in BANKS_RATIO:
        fall_mps2 = GRAVITY_MPS2 * math.sin(math.atan(bank))
        for mu in FRICTIONS_MU:
            steer = 0.02 * mu * SAMPLE_S * np.arange(2000, dtype=np.float64)
            motion = drive_open_loop(Plane(mu, cross_slope_ratio=-bank), speed_mps=30.0, steer_rad=steer)
            mean = _moving_mean(motion.accel_y_mps2, 0.5)
            best = int(np.argmax(mean))
            normal = float(motion.wheel_load_n[best : best + 50].sum(axis=1).mean()) / XC90.mass_kg
            limit = lateral_limit_mps2(mu, normal_mps2=normal) + fall_mps2
            rows.append(
                {
                    "mu": mu,
                    "bank_ratio": bank,
                    "largest_mps2": float(mean[best]),
                    "over_load_sensitive_limit_ratio": float(mean[best]) / limit,
                    "over_mu_g_ratio": float(mean[best]) / (mu * GRAVITY_MPS2 + fall_mps2),
                }
            )
    for bank, colour in zip(BANKS_RATIO, (OURS, THIRD), strict=True):
        some = [r for r in rows if r["bank_ratio"] == bank]
        mus = np.array(FRICTIONS_MU)
        fall_mps2 = GRAVITY_MPS2 * math.sin(math.atan(bank))
        limits = [r["largest_mps2"] / r["over_load_sensitive_limit_ratio"] for r in some]
        axes.plot(mus, limits, color=THEORY, linestyle="--", linewidth=1.2)
        axes.plot(mus, mus * GRAVITY_MPS2 + fall_mps2, color=QUIET, linestyle=":", linewidth=1.0)
        axes.plot(mus, [r["largest_mps2"] for r in some], "o", color=colour, ms=4)
    legend(axes, ("bank 0 %", OURS), ("bank 8 %, helping", THIRD))
    legend(axes, ("dashed: tyres at their loads", THEORY), ("dotted: mu g and bank", QUIET), x=0.5, top=0.14)
    label(axes, "Largest lateral acceleration", x="mu", y="m/s²")
    return rows


def _push(limit_mps2: float, mu: float, *, sign: float, car: Vehicle) -> float:
    """Return the largest tyre force over mass (0.1 s mean) while the pedal is pressed slowly harder, beyond the limit.

    Args:
        limit_mps2: With every tyre at its peak.
        mu: Friction.
        sign: Of the acceleration.
        car: For the share of the torque per axle.
    """
    share = np.concatenate([np.linspace(0.0, 0.7, 100), np.linspace(0.7, 1.15, 500)])
    motion = drive_open_loop(
        Plane(mu),
        speed_mps=70.0 if sign < 0.0 else 4.0,
        steer_rad=np.zeros(len(share)),
        accel_mps2=sign * limit_mps2 * share,
        vehicle=car._replace(power_w=1e7, engine_brake_mps2=0.0, drag_npm2ps2_ratio=0.0),
    )
    return float(_moving_mean(sign * motion.accel_x_mps2, 0.1).max())


def _longitudinal(axes: Any) -> list[dict[str, float]]:
    rows = []
    for mu in FRICTIONS_MU:
        row = {"mu": mu}
        for word, sign in (("braking", -1.0), ("driving", 1.0)):
            limit, front_frac = longitudinal_limit(mu, sign=sign)
            balanced = XC90._replace(front_brake_frac=front_frac, front_drive_frac=front_frac)
            found = _push(limit, mu, sign=sign, car=balanced)
            row |= {
                f"{word}_limit_mps2": limit,
                f"{word}_balanced_mps2": found,
                f"{word}_balanced_over_limit_ratio": found / limit,
                f"{word}_balanced_over_mu_g_ratio": found / (mu * GRAVITY_MPS2),
                f"{word}_own_split_over_limit_ratio": _push(limit, mu, sign=sign, car=XC90) / limit,
            }
        rows.append(row)
    mus = np.array(FRICTIONS_MU)
    for word, colour in (("braking", OURS), ("driving", THIRD)):
        for split, marker in (("balanced", "o"), ("own_split", "x")):
            share = [100.0 * row[f"{word}_{split}_over_limit_ratio"] for row in rows]
            axes.plot(mus, share, marker, color=colour, ms=4, linestyle="-" if marker == "o" else ":", linewidth=1.0)
    axes.axhline(100.0, color=THEORY, linestyle="--", linewidth=1.2)
    axes.set_ylim(60.0, 105.0)
    legend(
        axes,
        ("braking", OURS),
        ("driving, power without end", THIRD),
        ("dots: torque shared like the load", QUIET),
        ("crosses: the car's own split", QUIET),
        ("dashed: every tyre at its peak, at its load", THEORY),
        top=0.34,
    )
    label(axes, "Largest force along over its limit", x="mu", y="%")
    return rows


def _stop_m(motion: Motion) -> float:
    end = int(np.argmax(motion.velocity_x_mps < STOP_TO_MPS))
    if end == 0:
        raise RuntimeError("the car did not stop in time")
    return float(motion.velocity_x_mps[:end].sum() * SAMPLE_S)


def ideal_stop_m(mu: float) -> float:
    """Return the distance of a stop with every tyre at its peak all the time, air helping.

    Args:
        mu: Friction.
    """
    speed = np.linspace(STOP_TO_MPS, STOP_FROM_MPS, 400)
    decel = longitudinal_limit(mu, sign=-1.0)[0] + XC90.drag_npm2ps2_ratio * speed**2 / XC90.mass_kg
    return float(np.trapezoid(speed / decel, speed))


def _full_braking(mu: float, systems: StabilitySystems) -> Motion:
    samples = round((STOP_FROM_MPS / (0.5 * mu * GRAVITY_MPS2) + 2.0) / SAMPLE_S)
    return drive_open_loop(
        Plane(mu),
        speed_mps=STOP_FROM_MPS,
        steer_rad=np.zeros(samples),
        accel_mps2=np.full(samples, -12.0),
        systems=systems,
    )


def _stops(axes: Any, example: Any) -> list[dict[str, float]]:
    rows = []
    for mu in FRICTIONS_MU:
        with_abs, locked = _full_braking(mu, ONLY_ABS), _full_braking(mu, NO_SYSTEMS)
        ideal = ideal_stop_m(mu)
        rows.append(
            {
                "mu": mu,
                "ideal_m": ideal,
                "abs_m": _stop_m(with_abs),
                "locked_m": _stop_m(locked),
                "abs_efficiency_ratio": ideal / _stop_m(with_abs),
                "locked_efficiency_ratio": ideal / _stop_m(locked),
            }
        )
        if mu == 0.35:
            until = int(np.argmax(with_abs.velocity_x_mps < STOP_TO_MPS))
            time = with_abs.time_s[:until]
            line(example, time, with_abs.velocity_x_mps[:until], QUIET)
            radius = XC90.tyre.rolling_radius_m
            for wheel, colour in ((0, OURS), (2, THIRD)):
                line(example, time, with_abs.wheel_speed_radps[:until, wheel] * radius, colour, linewidth=0.9)
            legend(example, ("front wheel", OURS), ("rear wheel", THIRD), ("car", QUIET), top=0.22)
    for key, colour, word in (
        ("abs_efficiency_ratio", OURS, "ABS"),
        ("locked_efficiency_ratio", THEORY, "locked wheels"),
    ):
        share = [100.0 * r[key] for r in rows]
        axes.plot(FRICTIONS_MU, share, "o-", color=colour, ms=4)
        name(axes, FRICTIONS_MU[-1], share[-1], word, colour, ha="right", xytext=(0, 6))
    axes.set_ylim(50.0, 105.0)
    axes.axhline(100.0, color=QUIET, linestyle=":", linewidth=1.0)
    label(axes, "Stop from 90 km/h: ideal over distance", x="mu", y="%")
    label(example, "ABS at mu 0.35", x="time, s", y="m/s")
    return rows


def _dwell(axes: Any) -> dict[str, Any]:
    """Steer a sine of 0.7 Hz that waits half a second at its second peak, from 80 km/h, ever larger."""
    time = SAMPLE_S * np.arange(500, dtype=np.float64) - 0.2
    half, pause = 0.75 / 0.7, 0.5
    phase = np.where(time < half, time, np.maximum(half, time - pause))
    wave = np.where((time > 0.0) & (phase < 1.0 / 0.7), np.sin(2.0 * np.pi * 0.7 * phase), 0.0)
    angles = np.radians(np.arange(0.5, 8.01, 0.5))
    figures: dict[str, Any] = {"friction_mu": DWELL_FRICTION_MU}
    for systems, colour, word in ((NO_SYSTEMS, THEORY, "without ESC"), (ONLY_ESC, OURS, "with ESC")):
        worst = []
        for angle in angles:
            motion = drive_open_loop(
                Plane(DWELL_FRICTION_MU), speed_mps=22.2, steer_rad=float(angle) * wave, systems=systems
            )
            worst.append(float(np.abs(np.arctan2(motion.velocity_y_mps, motion.velocity_x_mps)).max()))
        axes.plot(np.degrees(angles), np.degrees(worst), "o-", color=colour, ms=3.5)
        name(axes, math.degrees(angles[-1]), math.degrees(worst[-1]), word, colour, ha="right", xytext=(0, 6))
        spun = [math.degrees(a) for a, w in zip(angles, worst, strict=True) if w > math.radians(20.0)]
        key = "without_esc" if systems == NO_SYSTEMS else "with_esc"
        figures[f"{key}_largest_sideslip_rad"] = max(worst)
        figures[f"{key}_spins_from_steer_rad"] = math.radians(spun[0]) if spun else None
    label(
        axes,
        f"Sine with dwell from 80 km/h, mu {DWELL_FRICTION_MU}",
        x="steering amplitude, °",
        y="largest sideslip, °",
    )
    return figures


def _on_the_road(axes: Any) -> list[dict[str, float | str]]:
    section = read_section("s-turn")
    rows: list[dict[str, float | str]] = []
    for kind, style in ((DriverKind.PRUDENT, "-"), (DriverKind.REACTING, "--")):
        for esc_on, colour in ((True, OURS), (False, THEORY)):
            share = []
            for mu in ROAD_FRICTIONS_MU:
                rng = np.random.default_rng(SEED)
                plans = [draw_plan(rng, section=section, base_friction_mu=mu, kind=kind) for _ in range(RUNS_COUNT)]
                systems = StabilitySystems(esc_on=esc_on)
                drives = simulate_passages(section, [replace(plan, stability=systems) for plan in plans])
                share.append(sum(drive.completed for drive in drives) / RUNS_COUNT)
                spun = sum(drive.outcome.value == "spun" for drive in drives) / RUNS_COUNT
                rows.append(
                    {
                        "driver": kind.value,
                        "esc": "on" if esc_on else "off",
                        "mu": mu,
                        "on_the_road_frac": share[-1],
                        "spun_frac": spun,
                    }
                )
            axes.plot(ROAD_FRICTIONS_MU, 100.0 * np.array(share), "o", linestyle=style, color=colour, ms=3.5)
    legend(axes, ("ESC on", OURS), ("ESC off", THEORY), ("dashed: reacting", QUIET), x=0.66, top=0.21)
    axes.set_ylim(-3.0, 103.0)
    label(axes, f"S-turn: {RUNS_COUNT} drives each, on the road", x="base friction", y="%")
    return rows
