"""What a tuning changed: the sideslip of a drive, true, before and after."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from roadgrip.units import SAMPLE_RATE_HZ
from training.observer_tuning import estimated_sideslip_rad
from training.reference_drives import ReferenceDrive
from vehicle_client.estimation.observer import ObserverParameters

SHOWN_S = 60.0
_EVERY_COUNT = 5
_STYLE = {"svg.fonttype": "none", "svg.hashsalt": "roadgrip", "font.size": 9.0, "font.sans-serif": ["DejaVu Sans"]}


def draw_tuning(drive: ReferenceDrive, *, before: ObserverParameters, after: ObserverParameters, path: Path) -> None:
    """Write a picture of the minute of a drive with most sideslip.

    Args:
        drive: The drive.
        before: Constants.
        after: Other constants.
        path: The file; its ending names the format. An SVG is the same for the same drive, byte for byte.
    """
    minute_count = min(int(SHOWN_S * SAMPLE_RATE_HZ), drive.trace.samples_count)
    power = np.convolve(np.where(drive.judged, drive.sideslip_rad, 0.0) ** 2, np.ones(minute_count), mode="valid")
    first = int(np.argmax(power))
    shown = slice(first, first + minute_count, _EVERY_COUNT)
    time_s = (drive.trace.time_s - drive.trace.time_s[0])[shown]
    with rc_context(_STYLE):
        figure = Figure(figsize=(9.0, 3.4), layout="constrained")
        axes = figure.subplots()
        for values, text, colour in (
            (np.where(drive.judged, drive.sideslip_rad, np.nan), "reference", "#555555"),
            (estimated_sideslip_rad(drive, before), "before", "#c65a11"),
            (estimated_sideslip_rad(drive, after), "after", "#1f5fa8"),
        ):
            axes.plot(time_s, np.degrees(values[shown]), color=colour, label=text, linewidth=1.3)
        axes.set_xlabel("s")
        axes.set_ylabel("sideslip, deg")
        axes.set_title(drive.name, loc="left")
        axes.legend(frameon=False, ncols=3)
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
