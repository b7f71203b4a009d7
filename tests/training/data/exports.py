"""Exports as a unit writes them, with passages that can have happened."""

from __future__ import annotations

import gzip
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from roadgrip.features import NEWEST_TABLE, FeatureTable
from roadgrip.passage_export import ExportedPassage, ExportHead, head_to_json, passage_to_json
from roadgrip.section import RoadSection
from roadgrip.section_file import section_to_json
from tests.rsu_app.fakes import NOON_UNIX_S, make_passage, make_section

BEND = make_section("bend")


def exported(
    seed: int = 0,
    *,
    section: RoadSection = BEND,
    left_unix_s: float = NOON_UNIX_S,
    table: FeatureTable = NEWEST_TABLE,
    **changes: Any,
) -> ExportedPassage:
    """Return a passage as a unit exports it; another one for every seed."""
    passage = make_passage(section, seed=seed, table=table)
    told = ExportedPassage(
        section_id=section.section_id,
        map_version=section.version,
        table_digest=table.digest,
        values=np.array(passage.summary.values, dtype=np.float32),
        duration_s=passage.summary.duration_s,
        quality=0,
        left_unix_s=left_unix_s,
        bundle_id="0" * 16,
        mu=0.5,
        flags=0,
        expected_error_ratio=None,
        mu_low=None,
        at_least=False,
        shadow_bundle_id=None,
        shadow_mu=None,
    )
    return replace(told, **changes)


def head_of(*sections: RoadSection, **changes: Any) -> ExportHead:
    """Return the head of an export with the maps of some sections."""
    head = ExportHead(
        unit="unit-1",
        exported_unix_s=NOON_UNIX_S + 7200.0,
        since_unix_s=NOON_UNIX_S - 7200.0,
        until_unix_s=NOON_UNIX_S + 7200.0,
        sections_json={section.version: section_to_json(section) for section in sections},
        bundle_id="0" * 16,
        ledger_hash="ab" * 32,
        software="1.0",
    )
    return replace(head, **changes)


def export_text(passages: Sequence[ExportedPassage], *, head: ExportHead | None = None) -> str:
    """Return the text of an export."""
    lines = [head_to_json(head or head_of(BEND)), *(passage_to_json(each) for each in passages)]
    return "".join(f"{line}\n" for line in lines)


def write_export(path: Path, passages: Sequence[ExportedPassage], *, head: ExportHead | None = None) -> Path:
    """Write an export, compressed where its name says so, and return where."""
    content = export_text(passages, head=head).encode()
    path.write_bytes(gzip.compress(content) if path.suffix == ".gz" else content)
    return path
