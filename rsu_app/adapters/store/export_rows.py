"""Rows to exported passages. What tells one vehicle from another is not even read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from sqlalchemy import ColumnElement, Connection, func, select, tuple_

from roadgrip.passage_export import ExportedPassage, coarse_unix_s
from rsu_app.adapters.store.schema import PASSAGES

Place: TypeAlias = tuple[str, float, int]
"""Where a passage stands in an export: section, moment of leaving it, number."""

_P = PASSAGES.c
_PLACE = (_P.section_id, _P.left_unix_s, _P.sequence_number)
_TOLD = (
    _P.map_version,
    _P.table_digest,
    _P.features,
    _P.duration_s,
    _P.quality,
    _P.bundle_id,
    _P.mu,
    _P.flags,
    _P.expected_error_ratio,
    _P.mu_low,
    _P.at_least,
    _P.shadow_bundle_id,
    _P.shadow_mu,
)


@dataclass(frozen=True, slots=True)
class Wanted:
    """Which passages are asked for.

    Attributes:
        since_unix_s: Those received from then on,
        until_unix_s: and before this.
        section_id: Of this section; None takes all.
    """

    since_unix_s: float
    until_unix_s: float
    section_id: str | None = None


def wanted_count(connection: Connection, wanted: Wanted) -> int:
    """Return how many passages are asked for."""
    return int(connection.execute(select(func.count()).select_from(PASSAGES).where(*_conditions(wanted))).scalar_one())


def passages_after(
    connection: Connection, wanted: Wanted, *, after: Place | None, limit_count: int
) -> list[tuple[Place, ExportedPassage]]:
    """Return the passages that follow a place, by section and moment of leaving, each with its own place.

    Args:
        connection: To the database.
        wanted: Which passages are asked for.
        after: The place of the last one before; None begins.
        limit_count: So many at most.
    """
    chosen = select(*_PLACE, *_TOLD).where(*_conditions(wanted))
    if after is not None and wanted.section_id is None:
        chosen = chosen.where(tuple_(*_PLACE) > after)
    elif after is not None:
        # With the section given twice SQLite would begin every batch at the section's first passage.
        chosen = chosen.where(tuple_(*_PLACE[1:]) > after[1:])
    found = connection.execute(chosen.order_by(*_PLACE).limit(limit_count))
    return [((row.section_id, row.left_unix_s, row.sequence_number), _exported(row)) for row in found]


def _conditions(wanted: Wanted) -> list[ColumnElement[bool]]:
    # Of a sum SQLite makes no use of the index over it: it shall go by section and leaving, and not sort at the end.
    received_unix_s = _P.received_unix_s + 0.0
    conditions = [received_unix_s >= wanted.since_unix_s, received_unix_s < wanted.until_unix_s]
    if wanted.section_id is not None:
        conditions.append(_P.section_id == wanted.section_id)
    return conditions


def _exported(row: Any) -> ExportedPassage:
    return ExportedPassage(
        section_id=row.section_id,
        map_version=row.map_version,
        table_digest=row.table_digest,
        values=np.frombuffer(row.features, dtype="<f4").astype(np.float32),
        duration_s=row.duration_s,
        quality=row.quality,
        left_unix_s=coarse_unix_s(row.left_unix_s),
        bundle_id=row.bundle_id,
        mu=row.mu,
        flags=row.flags,
        expected_error_ratio=row.expected_error_ratio,
        mu_low=row.mu_low,
        at_least=bool(row.at_least),
        shadow_bundle_id=row.shadow_bundle_id,
        shadow_mu=row.shadow_mu,
    )
