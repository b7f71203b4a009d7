"""Passages to rows and back; every statement about them that the store runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from sqlalchemy import Connection, delete, func, insert, or_, select
from sqlalchemy.dialects.sqlite import insert as sqlite_insert

from roadgrip.records import NotCounted
from rsu_app.adapters.store.schema import PASSAGES, PROBES
from rsu_app.domain.plausibility import summary_values
from rsu_app.ports import CountablePassage, PassageEntry, StoredEstimate

_P = PASSAGES.c
_ESTIMATE_COLUMNS = (
    _P.passage_id,
    _P.section_id,
    _P.content_digest,
    _P.values_digest,
    _P.mu,
    _P.flags,
    _P.left_unix_s,
    _P.bundle_id,
    _P.expected_error_ratio,
    _P.mu_low,
    _P.at_least,
    _P.shadow_bundle_id,
    _P.shadow_mu,
)


def insert_entries(connection: Connection, entries: Sequence[PassageEntry]) -> list[StoredEstimate | None]:
    """Store what is new; return per entry None, or what is held already under its id or with its values.

    An entry also meets those before it in the same group. There is one writer, so nothing can come between the
    question and the insert.
    """
    held = connection.execute(
        select(*_ESTIMATE_COLUMNS).where(
            or_(
                _P.passage_id.in_([e.estimate.passage_id for e in entries]),
                _P.values_digest.in_([e.estimate.values_digest for e in entries]),
            )
        )
    )
    by_id: dict[bytes, StoredEstimate] = {}
    by_values: dict[bytes, StoredEstimate] = {}

    def hold(estimate: StoredEstimate) -> None:
        by_id[estimate.passage_id] = estimate
        by_values[estimate.values_digest] = estimate

    for row in held:
        hold(_estimate(row))
    results: list[StoredEstimate | None] = []
    fresh: list[dict[str, Any]] = []
    for entry in entries:
        known = by_id.get(entry.estimate.passage_id) or by_values.get(entry.estimate.values_digest)
        if known is None:
            hold(entry.estimate)
            fresh.append(_passage_row(entry))
        results.append(known)
    if fresh:
        connection.execute(insert(PASSAGES), fresh)
    return results


def passages_since(connection: Connection, *, since_unix_s: float, limit_count: int) -> list[CountablePassage]:
    """Return what was received at or after a moment, oldest first; the newest `limit_count` of it."""
    newest_first = connection.execute(
        select(*_ESTIMATE_COLUMNS, _P.table_digest, _P.features)
        .where(_P.received_unix_s >= since_unix_s)
        .order_by(_P.received_unix_s.desc(), _P.sequence_number.desc())
        .limit(limit_count)
    )
    return [_countable(row) for row in newest_first][::-1]


def first_passages(
    connection: Connection, *, section_id: str, bundle_id: str, limit_count: int
) -> list[CountablePassage]:
    """Return the first passages of a section that a bundle judged, in the order in which vehicles left it."""
    first = connection.execute(
        select(*_ESTIMATE_COLUMNS, _P.table_digest, _P.features)
        .where(_P.section_id == section_id, _P.bundle_id == bundle_id)
        .order_by(_P.left_unix_s, _P.sequence_number)
        .limit(limit_count)
    )
    return [_countable(row) for row in first]


def compared_count(connection: Connection, *, bundle_id: str, shadow_bundle_id: str) -> int:
    """Return for how many passages one bundle was live and another answered beside it. Reads the whole table."""
    compared = select(func.count()).where(
        _P.bundle_id == bundle_id, _P.shadow_bundle_id == shadow_bundle_id, _P.shadow_mu.is_not(None)
    )
    return int(connection.execute(compared).scalar_one())


def passages_count(connection: Connection) -> int:
    """Return how many passages are stored."""
    return int(connection.execute(select(func.count()).select_from(PASSAGES)).scalar_one())


def newest_received_unix_s(connection: Connection) -> float:
    """Return when the newest passage was received, zero without any."""
    return float(connection.execute(select(func.max(_P.received_unix_s))).scalar_one() or 0.0)


def write_probe(connection: Connection, *, unix_s: float) -> None:
    """Overwrite the one row that exists for being overwritten."""
    row = {"probe_id": 1, "written_unix_s": unix_s}
    connection.execute(sqlite_insert(PROBES).values(row).on_conflict_do_update(set_=row))


def delete_received_before(connection: Connection, *, before_unix_s: float, batch_count: int) -> int:
    """Delete passages received before a moment, at most a batch of them; return how many went."""
    old = select(_P.sequence_number).where(_P.received_unix_s < before_unix_s).limit(batch_count)
    return connection.execute(delete(PASSAGES).where(_P.sequence_number.in_(old))).rowcount


def delete_first(connection: Connection, *, batch_count: int) -> int:
    """Delete the passages that arrived first; return how many went."""
    first = select(_P.sequence_number).order_by(_P.sequence_number).limit(batch_count)
    return connection.execute(delete(PASSAGES).where(_P.sequence_number.in_(first))).rowcount


def used_bytes(connection: Connection) -> int:
    """Return the size of what the database holds: its pages but those that wait to be used again."""
    count = {
        name: int(connection.exec_driver_sql(f"PRAGMA {name}").scalar_one())
        for name in ("page_count", "freelist_count", "page_size")
    }
    return (count["page_count"] - count["freelist_count"]) * count["page_size"]


def delete_first_beyond(connection: Connection, *, size_limit_bytes: int, batch_count: int) -> int:
    """Delete the passages that arrived first if the database holds more than a size; return how many went."""
    if used_bytes(connection) <= size_limit_bytes:
        return 0
    return delete_first(connection, batch_count=batch_count)


def _countable(row: Any) -> CountablePassage:
    return CountablePassage(
        estimate=_estimate(row),
        table_digest=row.table_digest,
        values=np.frombuffer(row.features, dtype="<f4").astype(np.float32),
    )


def _estimate(row: Any) -> StoredEstimate:
    return StoredEstimate(
        passage_id=row.passage_id,
        section_id=row.section_id,
        content_digest=row.content_digest,
        values_digest=row.values_digest,
        mu=row.mu,
        flags=NotCounted(row.flags),
        left_unix_s=row.left_unix_s,
        bundle_id=row.bundle_id,
        expected_error_ratio=row.expected_error_ratio,
        mu_low=row.mu_low,
        at_least=bool(row.at_least),
        shadow_bundle_id=row.shadow_bundle_id,
        shadow_mu=row.shadow_mu,
    )


def _passage_row(entry: PassageEntry) -> dict[str, Any]:
    passage, estimate = entry.passage, entry.estimate
    return {
        "passage_id": passage.passage_id,
        "section_id": passage.section_id,
        "map_version": passage.map_version,
        "table_digest": passage.summary.table_digest,
        "features": summary_values(passage.summary).astype("<f4").tobytes(),
        "duration_s": passage.summary.duration_s,
        "age_s": passage.age_s,
        "quality": int(passage.summary.quality),
        "received_unix_s": entry.received_unix_s,
        "left_unix_s": estimate.left_unix_s,
        "bundle_id": estimate.bundle_id,
        "mu": estimate.mu,
        "flags": int(estimate.flags),
        "content_digest": estimate.content_digest,
        "values_digest": estimate.values_digest,
        "expected_error_ratio": estimate.expected_error_ratio,
        "mu_low": estimate.mu_low,
        "at_least": int(estimate.at_least),
        "shadow_bundle_id": estimate.shadow_bundle_id,
        "shadow_mu": estimate.shadow_mu,
    }
