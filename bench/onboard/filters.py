"""What "order 30, 10 Hz, both ways" may mean, and how little hangs on it: the same drives through four smoothers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.signal import butter, sosfiltfilt, sosfreqz

from bench.onboard.agreement import Agreement, agreement, pooled
from bench.onboard.chapters import Figures
from bench.onboard.drives import GRADES, SEED, Watched, completed_drives, study_scenarios
from bench.validation.picture import OURS, QUIET, THEORY, label, legend, line, panels, write
from roadgrip.features import PAPER_TABLE, summary_for
from roadgrip.records import Rejected
from roadgrip.units import SAMPLE_RATE_HZ, FloatArray
from training.marked_tables import percent, table
from vehicle_client.estimation import filters
from vehicle_client.estimation.filters import CUTOFF_HZ, LowPass
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.simulator.plan import SensorGrade

BASE_FRICTIONS_MU = (0.2, 0.45, 0.7)
DRIVES_COUNT = 24
"""Per cell: scenario, base friction, grade of sensors."""
SIGNALS = ("steer", "sideslip", "sideslip_rate", "yaw_rate_excess", "speed")
"""In the order of the table of features, eleven statistics each."""
BUTTERWORTH_ORDER = 30
Smoother = Callable[..., FloatArray]


def scipy_butterworth(signal: FloatArray, lowpass: LowPass = LowPass.BUTTERWORTH) -> FloatArray:
    """Return the signal through somebody else's Butterworth filter of order 30, both ways. (n,)"""
    del lowpass
    sections = butter(BUTTERWORTH_ORDER, CUTOFF_HZ, fs=SAMPLE_RATE_HZ, output="sos")
    smooth: FloatArray = sosfiltfilt(sections, signal, padlen=min(len(signal) - 1, filters.BUTTERWORTH_REACH_COUNT))
    return smooth


def untouched(signal: FloatArray, lowpass: LowPass = LowPass.HAMMING_FIR) -> FloatArray:
    """Return the signal as it is. (n,)"""
    del lowpass
    return signal


def own_butterworth(signal: FloatArray, lowpass: LowPass = LowPass.BUTTERWORTH) -> FloatArray:
    """Return the signal through the client's own Butterworth filter. (n,)"""
    del lowpass
    return filters.smoothed(signal, LowPass.BUTTERWORTH)


READINGS: dict[str, tuple[str, Smoother]] = {
    "butterworth": ("Butterworth, order 30", own_butterworth),
    "scipy_butterworth": ("the same, by scipy's `sosfiltfilt`", scipy_butterworth),
    "none": ("no smoothing", untouched),
}


@contextmanager
def smoothing(smoother: Smoother) -> Iterator[None]:
    """Let the client smooth with another filter for a while: everywhere, offsets and rough speed included."""
    usual = filters.smoothed
    users = [
        module
        for name, module in list(sys.modules.items())
        if name.startswith("vehicle_client.") and module is not filters and getattr(module, "smoothed", None) is usual
    ]
    with ExitStack() as changed:
        for module in users:
            changed.enter_context(patch.object(module, "smoothed", smoother))
        yield


def draw(folder: Path) -> dict[str, Any]:
    """Draw the filters and what they change; return all figures.

    Args:
        folder: Where pictures go.
    """
    figures: dict[str, Any] = {"seed": SEED, "drives_per_cell_count": DRIVES_COUNT, "grades": {}}
    for grade in GRADES:
        print(f"    filters: {grade}", flush=True)
        gathered = {name: _Gathered() for name in ("hamming_fir", *READINGS)}
        for scenario in study_scenarios():
            for mu in BASE_FRICTIONS_MU:
                cell = completed_drives(scenario, grade, base_friction_mu=mu, drives_count=DRIVES_COUNT)
                _gather(gathered, list(cell))
        figures["grades"][grade.value] = {
            name: {"sideslip": pooled(found.errors, unit="rad")}
            | ({"change_over_spread": _change_figures(found)} if found.changes else {})
            for name, found in gathered.items()
        }
    figures["picture"] = _draw(figures["grades"], folder)
    return figures


@dataclass
class _Gathered:
    """What one filter gave.

    Attributes:
        errors: Of the sideslip, drive by drive.
        changes: Of the summaries' values over their spread within the cell; a table per cell. (drives, 55)
    """

    errors: list[Agreement] = field(default_factory=list)
    changes: list[FloatArray] = field(default_factory=list)


def paper_values(result: Summarised) -> tuple[float, ...]:
    """Return the paper's statistics, which go by what is smoothed. (55,)"""
    return summary_for(result.summary, PAPER_TABLE).values


def _gather(gathered: dict[str, _Gathered], cell: list[Watched]) -> None:
    usual = [(watched, watched.result) for watched in cell if isinstance(watched.result, Summarised)]
    values = np.array([paper_values(result) for _, result in usual])
    gathered["hamming_fir"].errors += [_error(watched, result) for watched, result in usual]
    for name, (_, smoother) in READINGS.items():
        changes = []
        for (watched, _), usual_values in zip(usual, values, strict=True):
            with smoothing(smoother):
                other = summarise_passage(watched.drive.trace, watched.road_map, vehicle=watched.run.geometry)
            if isinstance(other, Rejected):
                continue
            gathered[name].errors.append(_error(watched, other))
            changes.append(np.abs(np.array(paper_values(other)) - usual_values) / np.std(values, axis=0))
        gathered[name].changes.append(np.array(changes))


def _error(watched: Watched, result: Summarised) -> Agreement:
    station = watched.drive.truth.station_m
    inside = (station >= 0.0) & (station <= watched.road_map.length_m)
    return agreement(result.signals.sideslip_rad[inside], watched.drive.truth.sideslip_rad[inside])


def _change_figures(found: _Gathered) -> dict[str, Any]:
    """Return what another filter does to the summaries, over their spread within a cell."""
    change = np.concatenate(found.changes)
    by_feature = np.median(change, axis=0)
    by_signal = np.split(change, len(SIGNALS), axis=1)
    worst = int(np.argmax(by_feature))
    return {
        "q50_ratio": float(np.median(change)),
        "q95_ratio": float(np.quantile(change, 0.95)),
        "largest_ratio": float(change.max()),
        "most_changed_feature": PAPER_TABLE.kinematic[worst].name,
        "most_changed_q50_ratio": float(by_feature[worst]),
        "by_signal_q50_ratio": {name: float(np.median(some)) for name, some in zip(SIGNALS, by_signal, strict=True)},
        "by_feature_q50_ratio": {f.name: float(by_feature[k]) for k, f in enumerate(PAPER_TABLE.kinematic)},
    }


def _draw(grades: Figures, folder: Path) -> str:
    figure, axes = panels(1, 2, title="The low-pass filter: order 30, 10 Hz, forward and backward")
    frequency_hz = np.linspace(0.0, 25.0, 501)
    taps = filters.lowpass_taps()
    offset = np.arange(len(taps)) - (len(taps) - 1) / 2.0
    one_pass = np.cos(2.0 * np.pi * np.outer(frequency_hz, offset) / SAMPLE_RATE_HZ) @ taps
    line(axes[0], frequency_hz, one_pass**2, OURS)
    _, response = sosfreqz(
        butter(BUTTERWORTH_ORDER, CUTOFF_HZ, fs=SAMPLE_RATE_HZ, output="sos"), frequency_hz, fs=SAMPLE_RATE_HZ
    )
    line(axes[0], frequency_hz, np.abs(response) ** 2, THEORY, tolerance_ratio=1e-4)
    label(axes[0], "Both passes together", x="frequency, Hz", y="gain")
    legend(axes[0], ("Hamming window, 31 taps: ours", OURS), ("Butterworth, order 30", THEORY), x=0.5, top=0.9)

    changed = grades[SensorGrade.AUTOMOTIVE.value]
    for name, colour, aside in (("butterworth", THEORY, -0.12), ("none", QUIET, 0.12)):
        values = list(changed[name]["change_over_spread"]["by_feature_q50_ratio"].values())
        at = np.repeat(np.arange(len(SIGNALS)), len(values) // len(SIGNALS)) + aside
        axes[1].plot(at, np.maximum(values, 1e-5), "o", color=colour, markersize=4, alpha=0.6)
    axes[1].set_yscale("log")
    axes[1].set_xticks(range(len(SIGNALS)), [name.replace("_", "\n") for name in SIGNALS])
    label(axes[1], "Change of summary values, automotive", x="", y="median change over spread in a cell")
    legend(axes[1], ("Butterworth instead", THEORY), ("no smoothing", QUIET), top=0.97)
    return write(figure, folder, "filters")


def _changes_table(figures: Figures) -> str:
    rows = []
    for grade in GRADES:
        found = figures["grades"][grade.value]
        rows.append([f"Hamming FIR, 31 taps (ours), {grade}", _error_text(found["hamming_fir"]), "", "", "", ""])
        for name, (words, _) in READINGS.items():
            change = found[name]["change_over_spread"]
            rows.append(
                [
                    f"{words}, {grade}",
                    _error_text(found[name]),
                    *(percent(change[f"{q}_ratio"]) for q in ("q50", "q95", "largest")),
                    f"`{change['most_changed_feature']}` {percent(change['most_changed_q50_ratio'], digits=0)}",
                ]
            )
    head = ("filter", "sideslip error, °", "change over spread: median", "95 %", "largest", "most changed, median")
    return table(head, rows)


def _error_text(found: Figures) -> str:
    return f"{np.degrees(found['sideslip']['rms_error_rad']):.3f}"


TABLES = {"changes": _changes_table}
