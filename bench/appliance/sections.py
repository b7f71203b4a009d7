"""The sections that the unit under load serves: the packaged ones, and the same roads once more under other names.

A window holds 20,000 vehicles of a section, so six are needed for 100,000.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from bench.measurement import ROADS
from roadgrip.section import RoadSection
from roadgrip.section_file import section_to_json
from roadgrip.sections import read_section

TWIN_SUFFIX = "-back"


def served_sections() -> tuple[RoadSection, ...]:
    """Return them, the packaged ones first."""
    packaged = [read_section(name) for name in ROADS]
    twins = [replace(section, section_id=section.section_id + TWIN_SUFFIX) for section in packaged]
    return (*packaged, *twins)


def write_sections(folder: Path) -> str:
    """Write the files of those that are not packaged and return the settings that name all of them."""
    settings = "".join(f'[[sections]]\nfile = "{name}"\n' for name in ROADS)
    for section in served_sections()[len(ROADS) :]:
        (folder / f"{section.section_id}.json").write_text(section_to_json(section), encoding="utf-8")
        settings += f'[[sections]]\nfile = "{section.section_id}.json"\n'
    return settings
