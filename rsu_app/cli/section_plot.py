"""One figure that shows a section: plan, curvature, bank, road difficulty, height.

The layout is data (`section_panels`), made without any plotting library; `draw_section` paints it on a figure that
the caller made.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from roadgrip.units import mps_to_kph

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray

FIGURE_INCHES = (11.0, 7.5)
_BLUE, _ORANGE, _GREY = "#1f5fa8", "#c65a11", "#808080"


@dataclass(frozen=True, slots=True)
class PlotLine:
    """One line of a panel.

    Attributes:
        label: For the legend; empty shows none.
        values: Over the station of the profile. (n,)
        colour: As the plotting library spells it.
        dashed: Whether it is a reference rather than a property of the road.
    """

    label: str
    values: FloatArray
    colour: str
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class Panel:
    """Quantities that share one vertical axis, over the station."""

    title: str
    lines: tuple[PlotLine, ...]


def section_title(section: RoadSection) -> str:
    """Return the headline of the figure."""
    return (
        f"{section.name} ({section.section_id}, version {section.version}): {section.length_m:.0f} m, "
        f"tightest radius {section.tightest_radius_m:.0f} m, {mps_to_kph(section.speed_limit_mps):.0f} km/h"
    )


def section_panels(section: RoadSection) -> tuple[Panel, ...]:
    """Return what is drawn over the station, from top to bottom."""
    p = section.profile
    return (
        Panel("curvature (1/m), left positive", (PlotLine("", p.curvature_1pm, _BLUE),)),
        Panel(
            "bank (%), inward",
            (
                PlotLine("ideal, uncapped", 100.0 * p.ideal_bank_ratio, _GREY, dashed=True),
                PlotLine(f"bank ({section.bank_origin.value})", 100.0 * p.bank_ratio, _BLUE),
            ),
        ),
        Panel("road difficulty index", (PlotLine("", p.road_difficulty_ratio, _ORANGE),)),
        Panel("height above the start (m)", (PlotLine("", p.z_m - p.z_m[0], _BLUE),)),
    )


def draw_section(figure: Any, section: RoadSection) -> None:
    """Paint a section.

    Args:
        figure: An empty matplotlib figure, best of `FIGURE_INCHES` with a constrained layout.
        section: The map.
    """
    panels = section_panels(section)
    profile = section.profile
    left, right = figure.subfigures(1, 2, width_ratios=[1.0, 1.15])
    figure.suptitle(section_title(section), fontsize=11)

    plan = left.add_subplot()
    limit = float(abs(profile.curvature_1pm).max()) or 1.0
    dots = plan.scatter(
        profile.x_m,
        profile.y_m,
        c=profile.curvature_1pm,
        cmap="coolwarm_r",
        vmin=-limit,
        vmax=limit,
        s=14,
        linewidths=0,
    )
    plan.plot(profile.x_m, profile.y_m, color="black", linewidth=0.5)
    plan.plot(section.nodes_m[:, 0], section.nodes_m[:, 1], ".", color="black", markersize=2, label="nodes")
    for word, at in (("start", 0), ("end", -1)):
        plan.annotate(
            word,
            (profile.x_m[at], profile.y_m[at]),
            textcoords="offset points",
            xytext=(8, 4),
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )
    plan.set_aspect("equal", adjustable="datalim")
    plan.set_xlabel("east of the origin (m)")
    plan.set_ylabel("north of the origin (m)")
    plan.grid(visible=True, alpha=0.3)
    left.colorbar(
        dots,
        ax=plan,
        location="bottom",
        label="curvature (1/m): blue turns left, red right",
        aspect=40,
        ticks=[-limit, 0.0, limit],
        format="%.4f",
    )

    first = None
    for row, panel in enumerate(panels):
        axes = right.add_subplot(len(panels), 1, row + 1, sharex=first)
        first = first or axes
        for line in panel.lines:
            style = "--" if line.dashed else "-"
            axes.plot(profile.station_m, line.values, style, color=line.colour, linewidth=1.3, label=line.label)
        axes.axhline(0.0, color="black", linewidth=0.5)
        axes.set_title(panel.title, fontsize=9, loc="left")
        axes.grid(visible=True, alpha=0.3)
        if any(line.label for line in panel.lines):
            axes.legend(fontsize=8, loc="best", framealpha=0.8)
        if row < len(panels) - 1:
            axes.tick_params(labelbottom=False)
        else:
            axes.set_xlabel("station (m)")
