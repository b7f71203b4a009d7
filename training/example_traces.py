"""Three recorded drives with their labels, maps and car, so that somebody else can see the format by example."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from roadgrip.errors import ConfigurationError
from roadgrip.section_file import section_to_json
from roadgrip.sections import read_section
from training.drive_labels import LABELS_FILE_NAME
from training.scenarios import ATTEMPTS_PER_KEPT_RUN_COUNT
from training.trace_folder import SECTIONS_FOLDER_NAME, VEHICLE_FILE_NAME
from vehicle_client.recording.csv_table import csv_of_columns
from vehicle_client.recording.own_columns import columns_of_trace
from vehicle_client.simulator.drive import Drive
from vehicle_client.simulator.plan import draw_plan
from vehicle_client.simulator.run import simulate_passage
from vehicle_client.vehicle_profile import PAPER_VEHICLE, toml_of_profile

SEED = 7


class Example(NamedTuple):
    """One of the drives.

    Attributes:
        file_name: Of its trace.
        road: Name of a packaged section.
        base_friction_mu: What the road offers a new tyre.
        with_gnss: Whether the trace has position fixes.
        group: Drives of one road and group share an interval.
    """

    file_name: str
    road: str
    base_friction_mu: float
    with_gnss: bool
    group: str


EXAMPLES = (
    Example("dry-long-turn.csv", "long-turn", 0.70, with_gnss=True, group="dry"),
    Example("wet-s-turn.csv", "s-turn", 0.50, with_gnss=True, group="wet"),
    Example("snow-long-turn.csv", "long-turn", 0.30, with_gnss=False, group="snow"),
)


def write_examples(folder: Path) -> tuple[Path, ...]:
    """Write three simulated drives as a folder that `evaluate` reads, and return the files.

    Args:
        folder: Made if missing.

    Raises:
        ConfigurationError: One of the files is there already.
    """
    roads = {name: read_section(name) for name in {example.road for example in EXAMPLES}}
    maps = {folder / SECTIONS_FOLDER_NAME / f"{name}.json": section_to_json(road) for name, road in roads.items()}
    texts = {**maps, folder / VEHICLE_FILE_NAME: toml_of_profile(PAPER_VEHICLE)}
    traces = [folder / example.file_name for example in EXAMPLES]
    labels = folder / LABELS_FILE_NAME
    there = [path for path in (*texts, *traces, labels) if path.exists()]
    if there:
        raise ConfigurationError(f"{there[0]} is there already; choose another folder")
    (folder / SECTIONS_FOLDER_NAME).mkdir(parents=True, exist_ok=True)
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
    lines = ["file,label_mu,section,group"]
    for number, (example, path) in enumerate(zip(EXAMPLES, traces, strict=True)):
        drive = _driven(example, number)
        path.write_bytes(csv_of_columns(columns_of_trace(drive.trace)))
        lines.append(f"{example.file_name},{drive.label_mu:.4f},{example.road},{example.group}")
    labels.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return (*traces, labels, *texts)


def _driven(example: Example, number: int) -> Drive:
    """Return the first drive that comes through."""
    section = read_section(example.road)
    for attempt in range(ATTEMPTS_PER_KEPT_RUN_COUNT):
        rng = np.random.default_rng([SEED, number, attempt])
        plan = draw_plan(rng, section=section, base_friction_mu=example.base_friction_mu, with_gnss=example.with_gnss)
        drive = simulate_passage(section, plan)
        if drive.completed:
            return drive
    raise RuntimeError(f"nobody came through {example.road} at {example.base_friction_mu}")
