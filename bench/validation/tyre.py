"""The tyre alone: force over slip, load and friction, the published points, self-similarity, combined slip."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bench.validation.picture import OURS, QUIET, SERIES, THEORY, label, line, name, panels, write
from roadgrip.units import FloatArray
from vehicle_client.simulator.tyre import steady_force_n
from vehicle_client.simulator.vehicle import XC90

LOAD_SHARES = (0.5, 1.0, 1.5, 2.0)
FRICTIONS_MU = (0.1, 0.2, 0.35, 0.6, 0.8, 1.0)
SLIP_ANGLES_RAD = (0.02, 0.04, 0.08, 0.15)


def force_n(axis: str, slip: FloatArray, *, load_n: float, friction_mu: float) -> FloatArray:
    """Return the force in pure slip. (n,)

    Args:
        axis: `x` or `y`.
        slip: (n,)
        load_n: Of the wheel.
        friction_mu: Peak force over nominal load.
    """
    at = 0 if axis == "x" else 1
    slips = [(float(s), 0.0) if at == 0 else (0.0, float(s)) for s in slip]
    return np.array([steady_force_n(x, y, load_n, friction_mu, XC90.tyre)[at] for x, y in slips])


def draw(folder: Path) -> dict[str, Any]:
    """Draw the pictures of the tyre and return its figures.

    Args:
        folder: Where pictures go.
    """
    figure, axes = panels(2, 3, title="Tyre in steady state")
    figures: dict[str, Any] = {}
    for axis, panel, word in (("x", axes[0], "Longitudinal"), ("y", axes[1], "Lateral")):
        figures[f"published_points_{axis}"] = _loads(panel, axis, word)
    figures["self_similarity_largest_deviation_ratio"] = _frictions(axes[2], axes[3])
    figures["combined_slip"] = _combined(axes[4])
    figures["load_sensitivity"] = _sensitivity(axes[5])
    return figures | {"picture": write(figure, folder, "tyre")}


def _loads(axes: Any, axis: str, word: str) -> dict[str, float]:
    tyre = XC90.tyre
    peak, slide, at, slides_at, slope = (
        [getattr(tyre, f"{what}_{axis}{k}_ratio") for k in (1, 2)]
        for what in ("peak", "slide", "peak_slip", "slide_slip", "slope")
    )
    # On the surface of the published curve this axis peaks at its published force: friction equals that peak.
    slip = np.linspace(0.0, 1.1, 400)
    for share, colour in zip(LOAD_SHARES, SERIES, strict=False):
        load = share * tyre.nominal_load_n
        force = force_n(axis, slip, load_n=load, friction_mu=peak[0])
        line(axes, slip, force / 1e3, colour)
        name(axes, 1.1, force[-1] / 1e3, f"{load / 1e3:.1f} kN", colour, xytext=(2, -3))
    worst = dict.fromkeys(("slope", "peak", "slide"), 0.0)
    for k in (0, 1):
        load = (k + 1) * tyre.nominal_load_n
        small = 1e-6
        found = {
            "slope": force_n(axis, np.array([small]), load_n=load, friction_mu=peak[0])[0] / small / load / slope[k],
            "peak": force_n(axis, np.array([at[k]]), load_n=load, friction_mu=peak[0])[0] / load / peak[k],
            "slide": force_n(axis, np.array([slides_at[k]]), load_n=load, friction_mu=peak[0])[0] / load / slide[k],
        }
        worst = {key: max(worst[key], abs(float(found[key]) - 1.0)) for key in worst}
        axes.plot(
            [at[k], slides_at[k]], [peak[k] * load / 1e3, slide[k] * load / 1e3], "o", color=THEORY, ms=5, zorder=4
        )
    axes.set_xlim(0.0, 1.3)
    label(axes, f"{word} force; dots: published points", x="slip", y="force, kN")
    return {f"{key}_largest_error_ratio": value for key, value in worst.items()}


def _frictions(axes: Any, collapsed: Any) -> float:
    load = XC90.tyre.nominal_load_n
    slip = np.linspace(0.0, 0.6, 300)
    worst = 0.0
    for mu, colour in zip(FRICTIONS_MU, SERIES, strict=True):
        for axis, style in (("x", "--"), ("y", "-")):
            force = force_n(axis, slip, load_n=load, friction_mu=mu) / load
            line(axes, slip, force, colour, linestyle=style, linewidth=1.3)
            again = force_n(axis, mu * slip, load_n=load, friction_mu=mu) / load / mu
            alike = force_n(axis, slip, load_n=load, friction_mu=1.0) / load
            line(collapsed, slip, again, colour, linestyle=style, linewidth=1.3)
            worst = max(worst, float(np.abs(again - alike).max()))
        name(axes, 0.6, float(force[-1]), f"mu {mu:g}", colour, xytext=(3, -3))
    axes.set_xlim(0.0, 0.72)
    label(axes, "Force over load; lateral, dashed longitudinal", x="slip", y="force / load")
    label(collapsed, "The same over mu: one curve per axis", x="slip / mu", y="force / (load mu)")
    name(collapsed, 0.36, 0.93, f"largest deviation {worst:.0e}", QUIET)
    return worst


def _combined(axes: Any) -> dict[str, float]:
    tyre, load, mu = XC90.tyre, XC90.tyre.nominal_load_n, 0.8
    along = np.concatenate([-np.geomspace(1.5, 1e-4, 120), np.geomspace(1e-4, 1.5, 120)])
    largest = 0.0
    for angle, colour in zip(SLIP_ANGLES_RAD, SERIES[1:], strict=False):
        forces = np.array([steady_force_n(float(s), angle, load, mu, tyre) for s in along]) / (load * mu)
        line(axes, forces[:, 0], forces[:, 1], colour)
        largest = max(largest, float(np.hypot(forces[:, 0], forces[:, 1]).max()))
        top = int(np.argmax(forces[:, 1]))
        below = -10 if angle < SLIP_ANGLES_RAD[-1] else 4
        name(axes, forces[top, 0], forces[top, 1], f"{np.degrees(angle):.1f}°", colour, ha="center", xytext=(0, below))
    turn = np.linspace(0.0, np.pi, 100)
    axes.plot(np.cos(turn), np.sin(turn), color=THEORY, linestyle=":", linewidth=1.4)
    name(axes, -0.72, 0.72, "mu", THEORY, xytext=(-12, 3))
    axes.set_ylim(0.0, 1.18)
    label(axes, "Combined slip at constant slip angles, mu 0.8", x="longitudinal force / (load mu)", y="lateral")
    return {"largest_force_over_mu_load_ratio": largest}


def _sensitivity(axes: Any) -> dict[str, float]:
    share = np.linspace(0.1, 2.5, 60)
    slip = np.linspace(0.01, 0.7, 140)
    nominal = XC90.tyre.nominal_load_n
    figures = {}
    for axis, colour, word in (("x", THEORY, "longitudinal"), ("y", OURS, "lateral")):
        peak = np.array(
            [force_n(axis, slip, load_n=float(u) * nominal, friction_mu=1.0).max() / (u * nominal) for u in share]
        )
        line(axes, share * nominal / 1e3, peak, colour)
        name(axes, share[-1] * nominal / 1e3, float(peak[-1]), word, colour, ha="right", xytext=(0, 5))
        figures[f"peak_at_twice_the_load_{axis}_ratio"] = float(np.interp(2.0, share, peak))
    axes.axvline(nominal / 1e3, color=QUIET, linewidth=0.8, linestyle=":")
    name(axes, nominal / 1e3, 1.08, "nominal load: here mu is defined", QUIET)
    label(axes, "Peak force over load at mu 1", x="wheel load, kN", y="peak force / load")
    return figures
