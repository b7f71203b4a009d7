"""One simulated drive looked at closely: what was true, what the sensors made of it, a table and a picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from roadgrip.errors import ConfigurationError
from roadgrip.records import Rejected
from roadgrip.units import mps_to_kph
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.estimation.yaw_rate import yaw_rate_excess_radps
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.shell.fleet import simulator
from vehicle_client.shell.replay import made_to_json, refusal_text
from vehicle_client.shell.sources import write_trace_csv
from vehicle_client.simulator.plan import SensorGrade, draw_plan

if TYPE_CHECKING:
    from pathlib import Path

    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray
    from vehicle_client.simulator.drive import Drive

FIGURE_INCHES = (11.0, 8.5)
_TRUE, _ESTIMATED = "#808080", "#1f5fa8"


@dataclass(frozen=True, slots=True)
class SingleDrive:
    """A drive and what the onboard client made of it."""

    drive: Drive
    made: Summarised | Rejected


def drive_once(section: RoadSection, *, base_friction_mu: float, grade: SensorGrade, seed: int) -> SingleDrive:
    """Return one drive, fixed by its seed, and its summary.

    Raises:
        ConfigurationError: The simulator is not installed.
    """
    simulate_passage = simulator()
    plan = draw_plan(
        np.random.default_rng(seed),
        section=section,
        base_friction_mu=base_friction_mu,
        grade=grade,
        with_gnss=bool(section.anchors),
    )
    drive = simulate_passage(section, plan)
    return SingleDrive(drive, summarise_passage(drive.trace, section))


def sideslip_error_rad(driven: SingleDrive) -> float | None:
    """Return the root mean square error of the estimated sideslip inside the section; None without an estimate."""
    if isinstance(driven.made, Rejected):
        return None
    inside = driven.made.match.inside(driven.drive.trace.time_s)
    error = driven.made.signals.sideslip_rad - driven.drive.truth.sideslip_rad
    return float(np.sqrt(np.mean(error[inside] ** 2)))


def single_drive_to_json(driven: SingleDrive) -> dict[str, Any]:
    """Return the drive as JSON shows it."""
    drive = driven.drive
    return {
        "outcome": drive.outcome.value,
        "base_friction_mu": drive.plan.base_friction_mu,
        "friction_mu": drive.label_mu,
        "target_speed_mps": drive.plan.target_speed_mps,
        "peak_utilisation_ratio": drive.peak_utilisation_ratio,
        "peak_sideslip_rad": drive.peak_sideslip_rad,
        "esc_active_frac": drive.esc_active_frac,
        "sideslip_error_rad": sideslip_error_rad(driven),
        "passage": made_to_json(driven.made),
    }


def single_drive_table(driven: SingleDrive, section: RoadSection) -> Table:
    """Return the drive as a table for a person."""
    drive, made = driven.drive, driven.made
    speed = drive.truth.velocity_x_mps
    table = Table("what", "value", title=f"One drive over {section.name}", title_justify="left", show_header=False)
    table.add_row("the drive", drive.outcome.value.replace("_", " "))
    table.add_row("friction of the road", f"{drive.plan.base_friction_mu:.2f} for a new tyre")
    table.add_row("friction of these tyres", f"{drive.label_mu:.3f}")
    table.add_row("speed", f"{mps_to_kph(float(speed.min())):.0f} to {mps_to_kph(float(speed.max())):.0f} km/h")
    table.add_row("grip in use at most", f"{drive.peak_utilisation_ratio:.0%}")
    table.add_row("sideslip at most", f"{np.rad2deg(drive.peak_sideslip_rad):.1f} degrees")
    error_rad = sideslip_error_rad(driven)
    if isinstance(made, Rejected) or error_rad is None:
        table.add_row("summary", f"none: {refusal_text(made)}" if isinstance(made, Rejected) else "none")
    else:
        table.add_row("error of the estimated sideslip", f"{np.rad2deg(error_rad):.2f} degrees RMS")
        table.add_row("found by", f"{made.match.method.value}, confidence {made.match.confidence_frac:.2f}")
        table.add_row("summary", f"{len(made.summary.values)} numbers over {made.summary.duration_s:.1f} s")
    return table


def keep_trace(driven: SingleDrive, path: Path) -> None:
    """Write what the sensors saw, as `replay` reads it.

    Raises:
        ConfigurationError: The file cannot be written.
    """
    try:
        write_trace_csv(path, driven.drive.trace)
    except OSError as error:
        raise ConfigurationError(f"cannot write {path}: {error.strerror or error}") from error


def draw_drive(driven: SingleDrive, section: RoadSection, path: Path) -> None:
    """Draw path, speed, steering, sideslip and yaw rate excess of a drive.

    Raises:
        ConfigurationError: matplotlib is not installed, or the file cannot be written.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ConfigurationError("drawing needs matplotlib: pip install 'roadgrip[demo]'") from error
    drive, truth = driven.drive, driven.drive.truth
    signals = None if isinstance(driven.made, Rejected) else driven.made.signals
    figure = Figure(figsize=FIGURE_INCHES, layout="constrained")
    grid = figure.add_gridspec(4, 2, width_ratios=(1.0, 1.5))
    _draw_plan(figure.add_subplot(grid[:, 0]), drive, section)
    true_excess = yaw_rate_excess_radps(
        truth.yaw_rate_radps,
        truth.velocity_x_mps,
        truth.steer_rad,
        wheelbase_m=XC90.wheelbase_m,
        track_m=XC90.track_m,
    )
    rows = (
        ("speed, km/h", 3.6 * truth.velocity_x_mps, None if signals is None else 3.6 * signals.speed_mps),
        ("steering, degrees", _deg(truth.steer_rad), None if signals is None else _deg(signals.steer_rad)),
        ("sideslip, degrees", _deg(truth.sideslip_rad), None if signals is None else _deg(signals.sideslip_rad)),
        (
            "yaw rate excess,\ndegrees/s",
            _deg(true_excess),
            None if signals is None else _deg(signals.yaw_rate_excess_radps),
        ),
    )
    for number, (label, true, estimated) in enumerate(rows):
        axes = figure.add_subplot(grid[number, 1])
        axes.axvspan(0.0, section.length_m, color="#f2f2f2", zorder=0)
        axes.plot(truth.station_m, true, color=_TRUE, linewidth=2.5, label="true")
        if estimated is not None:
            axes.plot(truth.station_m, estimated, color=_ESTIMATED, linewidth=1.0, label="estimated on board")
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
        axes.tick_params(labelbottom=number == len(rows) - 1)
        if number == 0:
            axes.legend(loc="best", frameon=False)
    axes.set_xlabel("distance along the section, m (shaded: inside)")
    figure.suptitle(
        f"{section.name}: {drive.outcome.value.replace('_', ' ')}, friction {drive.label_mu:.2f}, "
        f"{drive.plan.sensor_grade.value} sensors, {drive.peak_utilisation_ratio:.0%} of the grip used"
    )
    try:
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"cannot draw into {path}: {error}") from error


def _draw_plan(axes: Any, drive: Drive, section: RoadSection) -> None:
    profile, truth = section.profile, drive.truth
    axes.plot(profile.x_m, profile.y_m, color="#d0d0d0", linewidth=7.0, solid_capstyle="butt", label="section")
    points = axes.scatter(
        truth.x_m[::5],
        truth.y_m[::5],
        c=truth.utilisation_ratio[::5],
        s=4,
        cmap="viridis",
        vmin=0.0,
        vmax=1.0,
        zorder=3,
    )
    axes.figure.colorbar(points, ax=axes, orientation="horizontal", label="share of the grip in use", shrink=0.8)
    axes.annotate("start", (profile.x_m[0], profile.y_m[0]), textcoords="offset points", xytext=(8, 8))
    axes.set_aspect("equal")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    axes.grid(alpha=0.3)


def _deg(angle_rad: FloatArray) -> FloatArray:
    return np.rad2deg(angle_rad)
