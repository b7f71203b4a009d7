"""The virtual sensor on three recorded cars, judged by their reference instruments."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.onboard.chapters import recordings_folder
from bench.onboard.recorded_sideslip import TUNED_FRAC, by_pull, improvements, racing_of, rms
from bench.onboard.recorded_speed import offset_figures, speed_figures
from bench.onboard.recorded_view import TABLES, draw_sideslip, draw_speed
from training.reference_drives import MOVING_MPS
from vehicle_client.recording.public import COMMA2K19_RAV4, FERRARI_250LM, IAC_AV21
from vehicle_client.shell.sources import read_recording

__all__ = ["TABLES", "draw"]

FERRARI = "revs_ferrari250lm_20140222_01_01_03.csv.gz"
INDY = "iac_av21_putnam_2023_run4_2.csv.gz"
MOTORWAY = "comma2k19_rav4_example1_seg40.csv.gz"


def draw(folder: Path) -> dict[str, Any]:
    """Draw sideslip and speed of the recorded cars; return all figures.

    Args:
        folder: Where pictures go.

    Raises:
        InputMissingError: The recordings are not here.
    """
    place = recordings_folder()
    racing = racing_of(read_recording(place / FERRARI, FERRARI_250LM), FERRARI_250LM.vehicle)
    indy = read_recording(place / INDY, IAC_AV21)
    motorway = read_recording(place / MOTORWAY, COMMA2K19_RAV4)
    better, recalibrated = improvements(racing)
    return {
        "moving_from_mps": MOVING_MPS,
        "tuned_frac": TUNED_FRAC,
        "ferrari": {
            "rms_truth_rad": rms(racing.truth_rad[racing.moving]),
            "rms_truth_second_half_rad": rms(racing.truth_rad[racing.moving & racing.later]),
            "by_pull": by_pull(racing),
            "improvements": better,
            "picture": draw_sideslip(racing, recalibrated, folder),
        },
        "indy": speed_figures(indy, IAC_AV21.vehicle) | {"missing": list(indy.missing)},
        "motorway": speed_figures(motorway, COMMA2K19_RAV4.vehicle)
        | {"offsets": offset_figures(motorway, COMMA2K19_RAV4.vehicle)},
        "speed_picture": draw_speed(
            {"Indy car AV-21": (indy, IAC_AV21.vehicle), "RAV4 on a motorway": (motorway, COMMA2K19_RAV4.vehicle)},
            folder,
        ),
    }
