"""Folders of made-up recorded drives: a road given by its curvature, and cars that drive it without sideslip."""

from __future__ import annotations

from pathlib import Path

from roadgrip.section import RoadSection
from roadgrip.section_file import section_to_json
from roadgrip.units import FloatArray
from tests.vehicle_client.synthetic import bump, drive_over, negative, road, s_turn
from vehicle_client.estimation.trace import Trace
from vehicle_client.recording.csv_table import csv_of_columns
from vehicle_client.recording.own_columns import columns_of_trace


def hairpin(station_m: FloatArray) -> FloatArray:
    """Return the curvature of one tight left bend within 250 m."""
    return bump(station_m, start_m=40.0, length_m=160.0, peak_1pm=1 / 35.0)


def roads() -> tuple[RoadSection, RoadSection]:
    """Return an S-turn and a hairpin."""
    return road(s_turn, section_id="s-bend"), road(hairpin, length_m=250.0, section_id="hairpin")


def drive(of: str = "s-bend", *, speed_mps: float = 15.0) -> Trace:
    """Return a drive over one of the roads, or over the S-turn's mirror image, which is neither."""
    if of == "hairpin":
        return drive_over(hairpin, length_m=250.0, speed_mps=min(speed_mps, 10.0))[0]
    return drive_over(s_turn if of == "s-bend" else negative(s_turn), speed_mps=speed_mps)[0]


def csv_of(trace: Trace, **more: FloatArray) -> bytes:
    """Return a drive as a file in our own columns, with more columns beside them."""
    return csv_of_columns(columns_of_trace(trace) | more)


def write_folder(folder: Path, labels: str = "") -> Path:
    """Write three drives over two roads, their maps and perhaps a file of labels."""
    (folder / "sections").mkdir(parents=True)
    for section in roads():
        (folder / "sections" / f"{section.section_id}.json").write_text(section_to_json(section), encoding="utf-8")
    for name, trace in (("slow.csv", drive(speed_mps=12.0)), ("quick.csv", drive()), ("tight.csv", drive("hairpin"))):
        (folder / name).write_bytes(csv_of(trace))
    if labels:
        (folder / "labels.csv").write_text(labels, encoding="utf-8")
    return folder
