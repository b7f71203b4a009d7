"""Pictures and tables of the recorded cars."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.onboard.laps import laps_of
from bench.onboard.recorded_sideslip import PULLS, Racing
from bench.onboard.recorded_speed import speeds_of
from bench.validation.picture import OURS, QUIET, THEORY, THIRD, headroom, label, legend, line, panels, write
from roadgrip.units import SAMPLE_RATE_HZ, FloatArray
from training.marked_tables import percent, table
from vehicle_client.estimation.observer import ObserverParameters
from vehicle_client.estimation.trace import WHEELS
from vehicle_client.estimation.vehicle_geometry import VehicleGeometry
from vehicle_client.recording.foreign import Recording

SHOWN_LAP = 3
"""The first whole lap of the half that nothing was fitted to."""
_DOT_EVERY_COUNT = 40
AVERAGED_S = 3.0
Figures = Mapping[str, Any]


def draw_sideslip(racing: Racing, recalibrated: ObserverParameters, folder: Path) -> str:
    """Draw a lap of sideslip, truth and estimates, and the scatter of the second half; return the file's name.

    Args:
        racing: The recording.
        recalibrated: What the tuner found on the first half.
        folder: Where the picture goes.
    """
    estimates = [
        (racing.estimate_rad(PULLS["to_zero"]), "F pulls to zero, as in the paper", THEORY),
        (racing.estimate_rad(PULLS["to_gripping_car"]), "constants of the XC90", THIRD),
        (racing.estimate_rad(recalibrated), "recalibrated on the first half", OURS),
    ]
    figure, axes = panels(1, 2, title="Ferrari 250 LM: sideslip on a race track")
    laps = laps_of(racing.recording.reference["velocity_x_mps"], racing.recording.trace.yaw_rate_radps)
    lap = laps.lap_number == SHOWN_LAP
    line(
        axes[0],
        laps.station_m[lap],
        np.degrees(racing.truth_rad[lap]),
        QUIET,
        tolerance_ratio=4e-3,
        linewidth=3.0,
        alpha=0.45,
    )
    for estimate, _, colour in estimates:
        line(axes[0], laps.station_m[lap], np.degrees(estimate[lap]), colour, tolerance_ratio=6e-3, linewidth=1.0)
    label(axes[0], f"Lap {SHOWN_LAP + 1}", x="m along the lap", y="sideslip, °")
    headroom(axes[0], 0.45)
    legend(axes[0], ("reference instrument", QUIET), *((text, colour) for _, text, colour in estimates), top=0.94)
    unseen = np.flatnonzero(racing.moving & racing.later)[::_DOT_EVERY_COUNT]
    for estimate, _, colour in (estimates[0], estimates[2]):
        axes[1].plot(
            np.degrees(racing.truth_rad[unseen]), np.degrees(estimate[unseen]), ".", color=colour, ms=2.0, alpha=0.6
        )
    reach = 1.1 * float(np.degrees(np.abs(racing.truth_rad[unseen]).max()))
    axes[1].plot([-reach, reach], [-reach, reach], color=QUIET, linewidth=0.8)
    label(axes[1], "Second half, every 0.4 s", x="reference, °", y="estimate, °")
    return write(figure, folder, "recorded_sideslip")


def draw_speed(cars: Mapping[str, tuple[Recording, VehicleGeometry]], folder: Path) -> str:
    """Draw the error of speed over time, a panel per car; return the file's name.

    Args:
        cars: Recordings by the name of the car.
        folder: Where the picture goes.
    """
    figure, axes = panels(1, len(cars), title="Speed from four wheels, each with its best rolling radius")
    for panel, (name, (recording, vehicle)) in zip(axes, cars.items(), strict=True):
        reference = recording.reference["velocity_x_mps"]
        speeds = speeds_of(recording, vehicle)
        time_s = recording.trace.time_s - recording.trace.time_s[0]
        for what, colour in (("mean", THEORY), ("block", OURS)):
            error = np.sqrt(_means((speeds[what] - reference) ** 2))
            line(panel, _means(time_s), 1e3 * error, colour, linewidth=1.2)
        label(panel, name, x="s", y="speed error, mm/s, RMS of 3 s")
        headroom(panel)
        legend(panel, ("plain mean of the wheels", THEORY), ("our speed block", OURS))
    return write(figure, folder, "recorded_speed")


def _means(values: FloatArray) -> FloatArray:
    count = int(AVERAGED_S * SAMPLE_RATE_HZ)
    whole = len(values) // count * count
    means: FloatArray = values[:whole].reshape(-1, count).mean(axis=1)
    return means


def _degrees(rad: float) -> str:
    return f"{math.degrees(rad):.2f}"


_PULL_WORDS = {
    "none": "none: claiming that there is no sideslip",
    "f_one_to_zero": "F = 1, to zero",
    "our_f_to_zero": "our F, to zero (the paper)",
    "f_zero_to_zero": "F = 0, to zero",
    "f_one_to_gripping_car": "F = 1, to the gripping car",
    "our_f_to_gripping_car": "our F, to the gripping car (what runs)",
    "f_zero_to_gripping_car": "F = 0, roll filter alone knows the gripping car",
    "gripping_car_alone": "the gripping car alone, no observer",
    "gripping_car_alone_fitted": "the same, its slip gradient fitted to the first half",
    "our_f_to_fitted_gripping_car": "our F, to the gripping car so fitted",
}
_STEP_WORDS = {
    "before": "the XC90's constants, no offsets",
    "offsets_causal": "offsets from the straights driven so far",
    "offsets_whole_recording": "offsets from the longest straight of the whole recording",
    "offset_by_reference": "lateral offset as the reference tells it",
    "no_roll_gradient": "a body that does not roll",
    "roll_gradient": "roll gradient as the reference tells it on the first half",
    "roll_gradient_slow_crossover": "the same, roll crossover at 0.02 Hz",
    "bank_own_sensors": "the same, and the bank that the other laps tell the car's own sensors",
    "bank": "roll gradient, and the bank that the reference tells on the other laps",
    "bank_slow_crossover": "the same, roll crossover at 0.02 Hz",
    "recalibrated_body": "recalibrated for this vehicle: slip and roll gradient, crossover",
    "recalibrated": "recalibrated for this vehicle: all constants",
}
_REGIME_WORDS = {
    "all": "all in motion",
    "braking": "braking, over 1 m/s²",
    "accelerating": "accelerating, over 1 m/s²",
    "cornering": "cornering steadily, over 2 m/s²",
    "steady": "else",
}


def _judged_cells(row: Figures) -> list[str]:
    return [
        _degrees(row["rms_error_rad"]),
        _degrees(row["rms_error_second_half_rad"]),
        f"{row['correlation_ratio']:.2f}",
        f"{row['gain_ratio']:.2f}",
    ]


_JUDGED_HEAD = ("RMS error, °", "second half alone, °", "correlation", "gain")


def _by_pull(figures: Figures) -> str:
    rows = figures["ferrari"]["by_pull"]
    return table(
        ("estimate", *_JUDGED_HEAD), [[words, *_judged_cells(rows[key])] for key, words in _PULL_WORDS.items()]
    )


def _improvements(figures: Figures) -> str:
    by_pull = figures["ferrari"]["improvements"]["rows"]
    lines = []
    for key, words in _STEP_WORDS.items():
        cells = []
        for pull in PULLS:
            row = by_pull[pull][key]
            cells += [
                _degrees(row["rms_error_rad"]),
                _degrees(row["rms_error_second_half_rad"]),
                f"{row['correlation_ratio']:.2f}",
            ]
        lines.append([words, *cells])
    head = ("", "F to zero, °", "second half alone, °", "correlation",
            "F to the gripping car, °", "second half alone, °", "correlation")  # fmt: skip
    return table(head, lines)


def _constants(figures: Figures) -> str:
    constants = figures["ferrari"]["improvements"]["recalibrated_constants"]
    return table(
        ("constant", "XC90", "Ferrari, first half"),
        [[f"`{name}`", f"{both['before']:.3g}", f"{both['after']:.3g}"] for name, both in constants.items()],
    )


def _speed(figures: Figures) -> str:
    lines = []
    for key, car in (("indy", "Indy car"), ("motorway", "RAV4")):
        errors = figures[key]["rms_error_mps"]
        for regime, seconds in figures[key]["seconds"].items():
            cells = [f"{1e3 * errors[name][regime]:.0f}" for name in ("block", "mean", "mean_smoothed")]
            lines.append([car, _REGIME_WORDS[regime], f"{seconds:.0f}", *cells])
    head = ("car", "doing", "seconds", "speed block, mm/s", "mean of four wheels, mm/s", "the mean, smoothed, mm/s")
    return table(head, lines)


def _radii(figures: Figures) -> str:
    lines = []
    for key, car in (("indy", "Indy car"), ("motorway", "RAV4")):
        best = figures[key]["best_radius_over_nominal_ratio"]
        lines.append([car, *(f"{best[name]:.4f}" for name in ("block", "mean", *WHEELS))])
    return table(("best radius over nominal", "block", "mean", *(wheel.replace("_", " ") for wheel in WHEELS)), lines)


def _weights(figures: Figures) -> str:
    lines = []
    for key, car in (("indy", "Indy car"), ("motorway", "RAV4")):
        for regime, weights in figures[key]["weight_frac"].items():
            lines.append([car, _REGIME_WORDS[regime], *(percent(weights[wheel]) for wheel in WHEELS)])
    return table(("car", "doing", *(wheel.replace("_", " ") for wheel in WHEELS)), lines)


def _motorway_offsets(figures: Figures) -> str:
    found = figures["motorway"]["offsets"]
    ways = {
        "none": "nothing",
        "straight": "what the straight tells",
        "by_reference": "all that the reference tells",
        "added": "nothing, and 0.26 m/s² more added to the sensor",
    }
    lines = [
        [words, *(f"{math.degrees(found['rms_error_rad'][way][name]):.2f}" for name in ("f_zero", "our_f", "f_one"))]
        for way, words in ways.items()
    ]
    return table(("subtracted from the lateral accelerometer", "F = 0, °", "our F, °", "F = 1, °"), lines)


TABLES: Mapping[str, Callable[[Figures], str]] = {
    "by_pull": _by_pull,
    "improvements": _improvements,
    "constants": _constants,
    "speed": _speed,
    "radii": _radii,
    "weights": _weights,
    "motorway_offsets": _motorway_offsets,
}
