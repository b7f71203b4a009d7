"""One drive on one page: where the car went, what it did, what was believed on board, and what its tyres bore.

Grey is what was true, blue what the onboard client estimated. Everything but the plan and the circle of grip is drawn
over the distance along the section, which is shaded.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from roadgrip.errors import ConfigurationError
from roadgrip.records import Rejected
from roadgrip.units import GRAVITY_MPS2, KPH_PER_MPS, SAMPLE_S
from vehicle_client.estimation.yaw_rate import yaw_rate_excess_radps
from vehicle_client.shell.replay import refusal_text
from vehicle_client.shell.single_drive import activities_of, outcome_text

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

    from roadgrip.section import RoadSection
    from roadgrip.units import BoolArray, FloatArray
    from vehicle_client.shell.single_drive import SingleDrive
    from vehicle_client.simulator.drive import Truth
    from vehicle_client.simulator.vehicle import Vehicle

FIGURE_INCHES = (14.5, 9.0)
DOTS_PER_INCH = 100
TRUE, ESTIMATED, FRONT, REAR, BAD = "#9a9a9a", "#1f5fa8", "#1f5fa8", "#d9822b", "#b3261e"
FRONT_RIGHT, REAR_RIGHT = "#7fb2e5", "#f0bf86"
_SHADE, _INK = "#f1f3f5", "#333333"
_GRIP_COLOURS = ("#c9d9e8", "#6f9fd0", "#f0b429", "#c62d1f")
"""From no grip in use to all of it."""
_LOAD_MEAN_S = 0.3
_BEYOND_M = 30.0
"""Road that is shown beyond the point where a drive ended early."""
_PLAN_STEP = 5
"""Every so many samples of the path are a piece of one colour."""


class Line(NamedTuple):
    """One line of a panel.

    Attributes:
        name: As it stands above the panel; nothing there if empty.
        values: At every sample. (n,)
        colour: As the plotting library spells it.
        broad: Whether it lies below the others, as the truth under its estimate.
    """

    name: str
    values: FloatArray
    colour: str
    broad: bool = False


class Panel(NamedTuple):
    """Lines that share a vertical axis.

    Attributes:
        title: The quantity and its unit.
        lines: From the lowest to the topmost.
        from_zero: Whether the axis begins there.
    """

    title: str
    lines: tuple[Line, ...]
    from_zero: bool = False


def draw_drive(driven: SingleDrive, section: RoadSection, path: Path) -> None:
    """Draw a drive into a file.

    Raises:
        ConfigurationError: matplotlib is not installed, or the file cannot be written.
    """
    if path.is_dir():
        raise ConfigurationError(f"cannot draw into {path}: it is a folder")
    figure = drive_figure(driven, section)
    try:
        if path.suffix.lower() == ".png":
            _save_png(figure, path)
        else:
            figure.savefig(path)
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"cannot draw into {path}: {error}") from error


def drive_figure(driven: SingleDrive, section: RoadSection) -> Figure:
    """Return a drive as a figure, however it ended.

    Raises:
        ConfigurationError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ConfigurationError("drawing needs matplotlib: pip install 'roadgrip[demo]'") from error
    figure = Figure(figsize=FIGURE_INCHES, layout="constrained")
    halves: Any = figure.subfigures(1, 2, width_ratios=(1.0, 2.35))
    left, right = halves
    plan, grip = left.subplots(2, 1, height_ratios=(1.45, 1.0))
    _draw_path(plan, driven, section)
    _draw_circle(grip, driven)
    _colour_bar(left, (plan, grip))

    motion, tyres = motion_panels(driven), tyre_panels(driven.drive.truth, driven.drive.plan.vehicle)
    axes = right.subplots(len(motion), 2, sharex=True)
    for number, panel in enumerate(motion):
        _draw_panel(axes[number, 0], panel, driven, section)
    for number, panel in enumerate(tyres):
        _draw_panel(axes[number, 1], panel, driven, section)
    _draw_activities(axes[-1, 1], driven, section)
    for bottom in axes[-1]:
        bottom.set_xlabel("distance along the section, m (shaded: inside)", color=_INK)
    figure.suptitle(_headline(driven, section), fontsize=13, color=_INK)
    return figure


def _save_png(figure: Figure, path: Path) -> None:
    from PIL import Image

    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=DOTS_PER_INCH)
    # A page of few colours: with a palette it is a third as large.
    palette = Image.open(drawn).convert("RGB").quantize(colors=255)
    palette.save(path, optimize=True)


def motion_panels(driven: SingleDrive) -> tuple[Panel, ...]:
    """Return what the car did, and what was believed of it on board where there is a summary."""
    drive, truth = driven.drive, driven.drive.truth
    vehicle = drive.plan.vehicle
    excess = yaw_rate_excess_radps(
        truth.yaw_rate_radps,
        truth.velocity_x_mps,
        truth.steer_rad,
        wheelbase_m=vehicle.wheelbase_m,
        track_m=0.5 * (vehicle.front_track_m + vehicle.rear_track_m),
    )
    true = (
        ("speed, km/h", KPH_PER_MPS * truth.velocity_x_mps),
        ("steering, degrees", np.rad2deg(truth.steer_rad)),
        ("yaw rate, degrees/s", np.rad2deg(truth.yaw_rate_radps)),
        ("yaw rate excess, degrees/s", np.rad2deg(excess)),
        ("sideslip, degrees", np.rad2deg(truth.sideslip_rad)),
    )
    if isinstance(driven.made, Rejected):
        return tuple(Panel(title, (Line("", values, TRUE, broad=True),)) for title, values in true)
    signals = driven.made.signals
    estimated = (
        KPH_PER_MPS * signals.speed_mps,
        np.rad2deg(signals.steer_rad),
        np.rad2deg(signals.yaw_rate_radps),
        np.rad2deg(signals.yaw_rate_excess_radps),
        np.rad2deg(signals.sideslip_rad),
    )
    return tuple(
        Panel(title, (Line("true", values, TRUE, broad=True), Line("estimated on board", guess, ESTIMATED)))
        for (title, values), guess in zip(true, estimated, strict=True)
    )


def tyre_panels(truth: Truth, vehicle: Vehicle) -> tuple[Panel, ...]:
    """Return what the tyres bore; loads as means over 0.3 s, without the rattle of the road."""
    front_rad, rear_rad = axle_slip_rad(truth, vehicle)
    front, rear = axle_force_ratio(truth)
    load_kn = 1e-3 * truth.wheel_load_n
    names, colours = ("front left", "front right", "rear left", "rear right"), (FRONT, FRONT_RIGHT, REAR, REAR_RIGHT)
    return (
        Panel(
            "slip angle of the axles, degrees",
            (Line("front", np.rad2deg(front_rad), FRONT), Line("rear", np.rad2deg(rear_rad), REAR)),
        ),
        Panel(
            "friction, and what is used of it",
            (
                Line("there is", truth.friction_mu, TRUE, broad=True),
                Line("front", front, FRONT),
                Line("rear", rear, REAR),
            ),
            from_zero=True,
        ),
        Panel(
            "acceleration, m/s\u00b2",
            (Line("forward", truth.accel_x_mps2, REAR), Line("to the left", truth.accel_y_mps2, FRONT)),
        ),
        Panel(
            "wheel loads, kN",
            tuple(Line(names[i], moving_mean(load_kn[:, i]), colours[i]) for i in range(4)),
            from_zero=True,
        ),
    )


def axle_slip_rad(truth: Truth, vehicle: Vehicle) -> tuple[FloatArray, FloatArray]:
    """Return the angles between where the wheels of front and rear axle point and where they go, in the middle.

    Positive where the wheels point to the left of their path, as in a left turn: ISO 8855 with the sign turned round.

    Args:
        truth: The motion.
        vehicle: Where its axles are.
    """
    forward = truth.velocity_x_mps
    front_left_mps = truth.velocity_y_mps + vehicle.front_axle_m * truth.yaw_rate_radps
    rear_left_mps = truth.velocity_y_mps - vehicle.rear_axle_m * truth.yaw_rate_radps
    return truth.steer_rad - np.arctan2(front_left_mps, forward), -np.arctan2(rear_left_mps, forward)


def axle_force_ratio(truth: Truth) -> tuple[FloatArray, FloatArray]:
    """Return the resultant tyre force over the load of front and rear axle: the friction that they use."""
    used = [
        np.hypot(truth.wheel_force_x_n[:, axle].sum(axis=1), truth.wheel_force_y_n[:, axle].sum(axis=1))
        / np.maximum(1.0, truth.wheel_load_n[:, axle].sum(axis=1))
        for axle in (slice(0, 2), slice(2, 4))
    ]
    return used[0], used[1]


def tyre_force_ratio(truth: Truth, vehicle: Vehicle) -> tuple[FloatArray, FloatArray]:
    """Return the force of all tyres over the weight of the car, forward and to the left: what a g-g diagram shows.

    Unlike the acceleration it holds no gravity on a bank, so that friction bounds it.

    Args:
        truth: Forces and steering.
        vehicle: For its mass.
    """
    front_x, front_y = truth.wheel_force_x_n[:, :2].sum(axis=1), truth.wheel_force_y_n[:, :2].sum(axis=1)
    cosine, sine = np.cos(truth.steer_rad), np.sin(truth.steer_rad)
    forward = front_x * cosine - front_y * sine + truth.wheel_force_x_n[:, 2:].sum(axis=1)
    left = front_x * sine + front_y * cosine + truth.wheel_force_y_n[:, 2:].sum(axis=1)
    weight_n = vehicle.mass_kg * GRAVITY_MPS2
    return forward / weight_n, left / weight_n


def moving_mean(values: FloatArray) -> FloatArray:
    """Return a centred mean over 0.3 s, over less at the ends. (n,)"""
    window = np.ones(round(_LOAD_MEAN_S / SAMPLE_S) | 1)[: max(1, len(values))]
    return np.convolve(values, window, mode="same") / np.convolve(np.ones(len(values)), window, mode="same")


def stretches(active: BoolArray) -> list[tuple[int, int]]:
    """Return the first index of every run of true samples, and the index behind its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], active, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _headline(driven: SingleDrive, section: RoadSection) -> str:
    drive = driven.drive
    words = [
        f"{section.name}: {outcome_text(driven)}",
        f"lowest friction {drive.label_mu:.2f}",
        f"{drive.peak_utilisation_ratio:.0%} of the grip used",
        f"{drive.plan.sensor_grade.value} sensors",
    ]
    if isinstance(driven.made, Rejected):
        words.append(f"no summary ({refusal_text(driven.made)})")
    return ", ".join(words)


def _grip_colours() -> Any:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("grip", _GRIP_COLOURS)


def _draw_path(axes: Any, driven: SingleDrive, section: RoadSection) -> None:
    from matplotlib.collections import LineCollection

    profile, truth = section.profile, driven.drive.truth
    axes.plot(profile.x_m, profile.y_m, color="#dfe3e6", linewidth=11.0, solid_capstyle="butt", zorder=1)
    # Pieces overlap by one point, so that no gap shows between them.
    points = np.column_stack([truth.x_m, truth.y_m])
    starts = range(0, max(1, len(points) - 1), _PLAN_STEP)
    path = LineCollection(
        [points[i : i + _PLAN_STEP + 1] for i in starts], cmap=_grip_colours(), linewidths=3.2, zorder=2
    )
    path.set_array(np.array([truth.utilisation_ratio[i : i + _PLAN_STEP].mean() for i in starts]))
    path.set_clim(0.0, 1.0)
    axes.add_collection(path)
    axes.autoscale_view()
    axes.plot(*points[0], marker="o", color=_INK, markersize=5, zorder=4)
    axes.annotate("start", points[0], textcoords="offset points", xytext=(8, -3), color=_INK)
    good = driven.drive.completed
    axes.plot(
        *points[-1], marker="o" if good else "X", color=_INK if good else BAD, markersize=5 if good else 12, zorder=5
    )
    axes.annotate(
        outcome_text(driven),
        points[-1],
        textcoords="offset points",
        xytext=(8, -3) if good else (10, -14),
        color=_INK if good else BAD,
        fontweight="normal" if good else "bold",
        bbox={"facecolor": "white", "alpha": 0.7, "linewidth": 0, "pad": 1.0},
        zorder=5,
    )
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("path, metres east and north", loc="left", fontsize=10, color=_INK)
    _quiet(axes)


def _draw_circle(axes: Any, driven: SingleDrive) -> None:
    from matplotlib.patches import Circle

    drive, truth = driven.drive, driven.drive.truth
    forward, left = tyre_force_ratio(truth, drive.plan.vehicle)
    lowest_mu, highest_mu = float(truth.friction_mu.min()), float(truth.friction_mu.max())
    circles = [(lowest_mu, "solid")]
    if highest_mu - lowest_mu > 0.02:
        circles.append((highest_mu, "dashed"))
    for mu, style in circles:
        axes.add_patch(Circle((0.0, 0.0), mu, fill=False, color=_INK, linestyle=style, linewidth=1.2))
        axes.annotate(
            f"friction {mu:.2f}", (0.0, mu), textcoords="offset points", xytext=(0, 3), ha="center", color=_INK
        )
    axes.scatter(left, forward, c=truth.utilisation_ratio, cmap=_grip_colours(), vmin=0.0, vmax=1.0, s=5, linewidths=0)
    reach = 1.2 * max(highest_mu, float(np.abs(forward).max()), float(np.abs(left).max()))
    # To the left is left.
    axes.set_xlim(reach, -reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal", adjustable="box")
    axes.axhline(0.0, color="#c8c8c8", linewidth=0.8, zorder=0)
    axes.axvline(0.0, color="#c8c8c8", linewidth=0.8, zorder=0)
    axes.set_title("force of the tyres over the car's weight", loc="left", fontsize=10, color=_INK)
    axes.set_xlabel("left turn (+)", color=_INK)
    axes.set_ylabel("brakes (-), drives (+)", color=_INK)
    _quiet(axes)


def _colour_bar(figure: Any, axes: tuple[Any, ...]) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import PercentFormatter

    bar = figure.colorbar(
        ScalarMappable(Normalize(0.0, 1.0), _grip_colours()),
        ax=list(axes),
        orientation="horizontal",
        shrink=0.85,
        aspect=30,
        format=PercentFormatter(1.0),
    )
    bar.set_label("share of the grip in use", color=_INK)
    bar.outline.set_visible(False)


def _draw_panel(axes: Any, panel: Panel, driven: SingleDrive, section: RoadSection) -> None:
    station = driven.drive.truth.station_m
    _lay_road(axes, driven, section)
    for line in panel.lines:
        axes.plot(station, line.values, color=line.colour, linewidth=2.4 if line.broad else 1.1, label=line.name or "_")
    if panel.from_zero:
        axes.set_ylim(0.0, 1.1 * max(float(line.values.max()) for line in panel.lines))
    axes.set_title(panel.title, loc="left", fontsize=10, color=_INK)
    if any(line.name for line in panel.lines):
        axes.legend(
            loc="lower right",
            bbox_to_anchor=(1.01, 0.98),
            ncols=len(panel.lines),
            frameon=False,
            borderpad=0.1,
            borderaxespad=0.0,
            handlelength=1.0,
            handletextpad=0.4,
            columnspacing=0.9,
            fontsize=8.5,
            labelcolor=_INK,
        )
    _quiet(axes)


def _draw_activities(axes: Any, driven: SingleDrive, section: RoadSection) -> None:
    station = driven.drive.truth.station_m
    _lay_road(axes, driven, section)
    activities = activities_of(driven.drive)
    for row, activity in enumerate(reversed(activities)):
        pieces = [(station[a], max(1.0, station[b - 1] - station[a])) for a, b in stretches(activity.active)]
        axes.broken_barh(pieces, (row - 0.36, 0.72), color=REAR if activity.on else "#cccccc", linewidth=0)
    axes.set_ylim(-0.6, len(activities) - 0.4)
    axes.set_yticks(range(len(activities)), [f"{a.system.upper()} {a.text}" for a in reversed(activities)], color=_INK)
    axes.set_title("at work, with the share inside the section", loc="left", fontsize=10, color=_INK)
    _quiet(axes)
    axes.grid(visible=False, axis="y")


def _lay_road(axes: Any, driven: SingleDrive, section: RoadSection) -> None:
    plan = driven.drive.plan
    last_m = section.length_m + plan.exit_m
    axes.axvspan(0.0, section.length_m, color=_SHADE, zorder=0)
    if not driven.drive.completed:
        ended_at_m = float(driven.drive.truth.station_m[-1])
        axes.axvline(ended_at_m, color=BAD, linewidth=1.2)
        last_m = min(last_m, ended_at_m + _BEYOND_M)
    axes.set_xlim(-plan.approach_m, last_m)


def _quiet(axes: Any) -> None:
    for side in ("top", "right", "left", "bottom"):
        axes.spines[side].set_visible(False)
    axes.grid(color="#d9dde1", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(length=0, labelsize=9, labelcolor=_INK)
