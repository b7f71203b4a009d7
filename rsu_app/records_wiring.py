"""The part of the composition root that knows what a unit keeps: its ledger, and passages for the laboratory."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from importlib.metadata import version as distribution_version
from pathlib import Path
from random import SystemRandom
from typing import TYPE_CHECKING

from roadgrip.errors import ConfigurationError
from roadgrip.ledger import LedgerEntry
from roadgrip.passage_export import TIME_STEP_S, ExportHead
from roadgrip.section_file import section_to_json
from rsu_app.bootstrap import load_sections
from rsu_app.export_file import ExportFailedError, step_before, write_export
from rsu_app.settings import Settings

if TYPE_CHECKING:
    from rsu_app.adapters.store import LedgerVerdict


@dataclass(frozen=True, slots=True)
class ExportRequest:
    """What an export shall hold.

    Attributes:
        since_unix_s: Passages received from then on; None begins with the oldest.
        until_unix_s: And before this; None goes on to the newest.
        section_id: Of this section; None takes all.
    """

    since_unix_s: float | None = None
    until_unix_s: float | None = None
    section_id: str | None = None


def ledger_entries(settings: Settings, *, limit_count: int) -> list[LedgerEntry]:
    """Return the newest entries of the unit's ledger, newest first.

    Raises:
        StoreError: There is no database, or it cannot be read.
        LedgerError: An entry is none.
    """
    from rsu_app.adapters.store import newest_entries

    return newest_entries(settings.database.path, limit_count=limit_count)


def verdict_on_ledger(settings: Settings, *, known_heads: Collection[str]) -> LedgerVerdict:
    """Return whether the unit's ledger holds together.

    Raises:
        StoreError: There is no database, or it cannot be read.
    """
    from rsu_app.adapters.store import ledger_verdict

    return ledger_verdict(settings.database.path, known_heads=known_heads)


def export_passages(
    settings: Settings,
    request: ExportRequest,
    path: Path,
    *,
    now_unix_s: float,
    on_written: Callable[[int, int], None] = lambda _count, _of_count: None,
) -> tuple[ExportHead, int]:
    """Return what an export says of itself and how many passages it holds, after it was written.

    Args:
        settings: What the operator chose.
        request: Which passages.
        path: Of the file.
        now_unix_s: The wall clock.
        on_written: Is told how many passages were written so far, and of how many.

    Raises:
        ConfigurationError: The operator chose no exports.
        ExportFailedError: The request names nothing, or the file cannot be written.
        StoreError: There is no database, or it cannot be read.
    """
    from rsu_app.adapters.store import Wanted, exported_passages, lineage, wanted_count

    if not settings.export.enabled:
        raise ConfigurationError(
            "this unit keeps no passages for others: export.enabled is false; docs/export.md says what it would tell"
        )
    sections = load_sections(settings)
    said = lineage(settings.database.path)
    # A unit whose clock runs ahead, in a demonstration, has received passages after now.
    newest_unix_s = max(now_unix_s, said.newest_received_unix_s)
    wanted = Wanted(
        since_unix_s=step_before(request.since_unix_s or 0.0),
        until_unix_s=step_before(newest_unix_s + TIME_STEP_S if request.until_unix_s is None else request.until_unix_s),
        section_id=request.section_id,
    )
    if not wanted.since_unix_s < wanted.until_unix_s:
        raise ExportFailedError(f"nothing can have come in between: the bounds are told to {TIME_STEP_S:.0f} s")
    count = wanted_count(settings.database.path, wanted)
    if not count and request.section_id not in {None, *(section.section_id for section in sections)}:
        raise ExportFailedError(f"there are no passages of {request.section_id!r}, nor is it served here")
    head = ExportHead(
        unit=settings.export.unit_name.strip(),
        exported_unix_s=now_unix_s,
        since_unix_s=wanted.since_unix_s,
        until_unix_s=wanted.until_unix_s,
        sections_json={section.version: section_to_json(section) for section in sections},
        bundle_id=said.bundle_id,
        ledger_hash=said.ledger_hash,
        software=distribution_version("roadgrip"),
    )
    written_count = write_export(
        path,
        head,
        exported_passages(settings.database.path, wanted),
        rng=SystemRandom(),
        on_written=lambda written_count: on_written(written_count, count),
    )
    return head, written_count
