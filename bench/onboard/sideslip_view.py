"""Pictures and tables of the sideslip chapter."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.onboard.drives import GRADES, SCENARIO_WORDS
from bench.onboard.variants import VARIANTS
from bench.validation.picture import (
    FOURTH,
    OURS,
    QUIET,
    THEORY,
    THIRD,
    headroom,
    label,
    legend,
    line,
    panels,
    plain_log_axes,
    write,
)
from roadgrip.units import FloatArray
from training.marked_tables import table
from vehicle_client.simulator.plan import SensorGrade


def draw_errors(grades: Mapping[str, Any], folder: Path) -> str:
    """Draw the error over friction, a panel per scenario; return the file's name."""
    figure, axes = panels(2, 2, title="Sideslip: error of the estimate over base friction")
    automotive, ideal = (grades[grade.value] for grade in (SensorGrade.AUTOMOTIVE, SensorGrade.IDEAL))
    for panel, name in zip(axes, automotive, strict=True):
        cells = automotive[name]["cells"]
        friction = _column(cells, "base_friction_mu")
        line(panel, friction, _degrees(cells, "rms_truth_rad"), QUIET, linewidth=3.0)
        for some, colour in ((cells, OURS), (ideal[name]["cells"], THIRD)):
            error, spread = _degrees(some, "rms_error_rad"), _degrees(some, "rms_error_standard_error_rad")
            panel.fill_between(friction, error - 2.0 * spread, error + 2.0 * spread, color=colour, alpha=0.15, lw=0)
            line(panel, friction, error, colour)
        for variant, colour in (("pull_to_zero", THEORY), ("softer_tyres", FOURTH)):
            values = np.degrees([cell["variants_rms_error_rad"][variant] for cell in cells])
            line(panel, friction, values, colour, linewidth=1.1, linestyle="--")
        panel.set_ylim(0.0, None)
        label(panel, SCENARIO_WORDS[name], x="base friction", y="RMS over the section, °")
        headroom(panel, 0.45)
    legend(
        axes[0],
        ("claiming that there is none", QUIET),
        ("estimate, automotive sensors (band: 2 standard errors)", OURS),
        ("estimate, ideal sensors", THIRD),
        ("F pulls to zero as in the paper, automotive", THEORY),
        ("rear tyres taken for 30 % softer, automotive", FOURTH),
        top=0.97,
    )
    return write(figure, folder, "sideslip")


def draw_gain(grades: Mapping[str, Any], folder: Path) -> str:
    """Draw gain and coherence over frequency; return the file's name."""
    figure, axes = panels(1, 2, title="Sideslip: what is seen of it, by how fast it changes")
    colours = dict(zip(SCENARIO_WORDS, (OURS, THEORY, THIRD, FOURTH), strict=True))
    for panel, key, words in (
        (axes[0], "gain_ratio", "estimate over truth"),
        (axes[1], "coherence_ratio", "coherence"),
    ):
        for grade, style in ((SensorGrade.AUTOMOTIVE, "-"), (SensorGrade.IDEAL, ":")):
            for name, found in grades[grade.value].items():
                edges = np.array(found["edges_hz"])
                line(panel, np.sqrt(edges[1:] * edges[:-1]), np.array(found[key]), colours[name], linestyle=style)
        plain_log_axes(panel, x=True)
        panel.set_xticks([0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0], ["0.05", "0.1", "0.2", "0.5", "1", "2", "5"])
        panel.minorticks_off()
        panel.set_ylim(-0.05, 1.35)
        label(panel, words.capitalize(), x="frequency, Hz", y=words)
    legend(axes[0], *((SCENARIO_WORDS[name], colour) for name, colour in colours.items()), x=0.6, top=0.45)
    legend(axes[1], ("dotted: ideal sensors", QUIET), x=0.3, top=0.2)
    return write(figure, folder, "sideslip_gain")


def _column(cells: list[dict[str, float]], key: str) -> FloatArray:
    return np.array([cell[key] for cell in cells])


def _degrees(cells: list[dict[str, float]], key: str) -> FloatArray:
    return np.degrees(_column(cells, key))


def _errors_table(figures: Mapping[str, Any]) -> str:
    rows = []
    for name in SCENARIO_WORDS:
        for grade in GRADES:
            found = figures["grades"][grade.value][name]["all_frictions"]["sideslip"]
            error, spread = (np.degrees(found[f"rms_error{kind}_rad"]) for kind in ("", "_standard_error"))
            rows.append(
                [
                    f"{SCENARIO_WORDS[name]}, {grade}",
                    f"{error:.2f} ± {spread:.3f}",
                    f"{np.degrees(found['rms_truth_rad']):.2f}",
                    f"{found['correlation_ratio']:.2f}",
                    f"{np.degrees(found['bias_rad']):+.2f}",
                    f"{100.0 * found['seen_of_peak_q50_ratio']:.0f} %",
                    " / ".join(f"{np.degrees(found[f'largest_error_{q}_rad']):.1f}" for q in ("q50", "largest")),
                ]
            )
    head = (
        "drives",
        "error, °",
        "none, °",
        "correlation",
        "bias, °",
        "seen of the peak",
        "largest error, °: median / worst drive",
    )
    return table(head, rows)


def _headline_table(figures: Mapping[str, Any]) -> str:
    rows = []
    for name, words in SCENARIO_WORDS.items():
        found = figures["grades"][SensorGrade.AUTOMOTIVE.value][name]
        ours, zero = found["all_frictions"]["sideslip"], found["variants"]["pull_to_zero"]
        rows.append(
            [words]
            + [f"{np.degrees(one['rms_error_rad']):.2f} ({one['correlation_ratio']:.2f})" for one in (ours, zero)]
            + [f"{np.degrees(ours['rms_truth_rad']):.2f}"]
        )
    return table(("sideslip error, ° (correlation)", "estimate", "with the paper's pull to zero", "none"), rows)


def _frictions_table(figures: Mapping[str, Any]) -> str:
    rows = []
    automotive = figures["grades"][SensorGrade.AUTOMOTIVE.value]
    for name, words in SCENARIO_WORDS.items():
        cells = automotive[name]["cells"]
        rows.append(
            [words] + [f"{np.degrees(c['rms_error_rad']):.2f} / {np.degrees(c['rms_truth_rad']):.2f}" for c in cells]
        )
    frictions = [f"{cell['base_friction_mu']:.2f}" for cell in next(iter(automotive.values()))["cells"]]
    return table(("error / none, °", *frictions), rows)


def _variants_table(figures: Mapping[str, Any]) -> str:
    def cells(of: Callable[[Mapping[str, Any]], Mapping[str, float]]) -> list[str]:
        return [
            " / ".join(f"{np.degrees(of(figures['grades'][g.value][name])['rms_error_rad']):.2f}" for g in GRADES)
            for name in SCENARIO_WORDS
        ]

    words = {name: variant.words for name, variant in VARIANTS.items()}
    rows = [["**as it is**", *cells(lambda found: found["all_frictions"]["sideslip"])]]
    rows += [[text, *cells(lambda found, name=name: found["variants"][name])] for name, text in words.items()]  # type: ignore[misc]
    return table(("error, °: automotive / ideal", *SCENARIO_WORDS.values()), rows)


def _cars_table(figures: Mapping[str, Any]) -> str:
    rows = []
    for name, words in SCENARIO_WORDS.items():
        found = figures["other_cars"][name]
        own = figures["grades"][SensorGrade.AUTOMOTIVE.value][name]["all_frictions"]["sideslip"]
        ours, zero = found["as_it_is"], found["pull_to_zero"]
        rows.append(
            [words]
            + [f"{np.degrees(one['rms_error_rad']):.2f} ({one['correlation_ratio']:.2f})" for one in (own, ours, zero)]
            + [f"{np.degrees(ours['rms_truth_rad']):.2f}"]
        )
    head = ("error, ° (correlation)", "the paper's car", "other cars", "other cars, F pulling to zero", "none")
    return table(head, rows)


_SIGNALS = {
    "sideslip_rate": ("sideslip rate, °/s", "radps", np.degrees(1.0)),
    "yaw_rate_excess": ("yaw rate excess, °/s", "radps", np.degrees(1.0)),
    "speed": ("speed, m/s", "mps", 1.0),
    "velocity_y": ("lateral velocity, m/s", "mps", 1.0),
    "chassis_roll": ("roll of the body, °", "rad", np.degrees(1.0)),
}


def _signals_table(figures: Mapping[str, Any]) -> str:
    rows = []
    for signal, (words, unit, factor) in _SIGNALS.items():
        for grade in GRADES:
            found = [figures["grades"][grade.value][name]["all_frictions"][signal] for name in SCENARIO_WORDS]
            rows.append(
                [f"{words}, {grade}"]
                + [
                    f"{factor * one[f'rms_error_{unit}']:.2f} of {factor * one[f'rms_truth_{unit}']:.2f}"
                    f" ({one['correlation_ratio']:.2f})"
                    for one in found
                ]
            )
    return table(("error of RMS (correlation)", *SCENARIO_WORDS.values()), rows)


TABLES = {
    "headline": _headline_table,
    "errors": _errors_table,
    "frictions": _frictions_table,
    "variants": _variants_table,
    "cars": _cars_table,
    "signals": _signals_table,
}
