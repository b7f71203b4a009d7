"""Passages to rows and back; every statement about them that the store runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from sqlalchemy import Connection, delete, func, or_, select, true, tuple_
from sqlalchemy.dialects.sqlite import insert as sqlite_insert
from sqlalchemy.exc import IntegrityError

from roadgrip.records import NotCounted
from rsu_app.adapters.store.schema import PASSAGES, PROBES
from rsu_app.ports import ArrivalKey, CountablePassage, PassageEntry, StoredEstimate

PORTION_COUNT = 64
"""Passages of one statement; SQLite binds 32,766 values, of which each passage takes twenty."""

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
    results: list[StoredEstimate | None] = []
    for portion in portions(entries):
        results += [None] * len(portion) if _inserted(connection, portion) else _inserted_if_new(connection, portion)
    return results


def portions(entries: Sequence[PassageEntry]) -> Iterator[Sequence[PassageEntry]]:
    """Yield the entries in portions whose sizes are powers of two, the largest first.

    So a handful of statements serve groups of any size, and each is parsed once.
    """
    start, size = 0, PORTION_COUNT
    while start < len(entries):
        while size > len(entries) - start:
            size //= 2
        yield entries[start : start + size]
        start += size


def _inserted(connection: Connection, portion: Sequence[PassageEntry]) -> bool:
    """Return whether the passages are stored now, which they nearly always are; if one is held already, none is.

    One statement for all: between two statements, or two rows of `executemany`, Python's lock goes to the thread that
    answers vehicles, and under load it takes its time with giving it back.
    """
    values = [value for entry in portion for value in _passage_row(entry)]
    try:
        connection.exec_driver_sql(_insert_of(len(portion)), tuple(values))
    except IntegrityError:
        # Nothing else is caught: at a full disk SQLite has undone the whole transaction.
        return False
    return True


def _inserted_if_new(connection: Connection, portion: Sequence[PassageEntry]) -> list[StoredEstimate | None]:
    held = _held(connection, portion)
    results: list[StoredEstimate | None] = []
    for entry in portion:
        estimate = entry.estimate
        known = held.by_id.get(estimate.passage_id) or held.by_values.get(estimate.values_digest)
        if known is None:
            held.add(estimate)
            connection.exec_driver_sql(_insert_of(1), _passage_row(entry))
        results.append(known)
    return results


@dataclass(frozen=True, slots=True)
class _Held:
    by_id: dict[bytes, StoredEstimate] = field(default_factory=dict)
    by_values: dict[bytes, StoredEstimate] = field(default_factory=dict)

    def add(self, estimate: StoredEstimate) -> None:
        self.by_id[estimate.passage_id] = estimate
        self.by_values[estimate.values_digest] = estimate


def _held(connection: Connection, entries: Sequence[PassageEntry]) -> _Held:
    rows = connection.execute(
        select(*_ESTIMATE_COLUMNS).where(
            or_(
                _P.passage_id.in_([e.estimate.passage_id for e in entries]),
                _P.values_digest.in_([e.estimate.values_digest for e in entries]),
            )
        )
    )
    held = _Held()
    for row in rows:
        held.add(_estimate(row))
    return held


def passages_since(
    connection: Connection, *, since_unix_s: float, limit_count: int, before: ArrivalKey | None = None
) -> list[CountablePassage]:
    """Return what was received since a moment and arrived before another; the newest of it, oldest first."""
    # A comparison of pairs, by which the index finds the place; two comparisons with an "or" read all that is newer.
    earlier = true() if before is None else tuple_(_P.received_unix_s, _P.sequence_number) < before
    newest_first = connection.execute(
        select(*_ESTIMATE_COLUMNS, _P.table_digest, _P.features, _P.received_unix_s, _P.sequence_number)
        .where(_P.received_unix_s >= since_unix_s, earlier)
        .order_by(_P.received_unix_s.desc(), _P.sequence_number.desc())
        .limit(limit_count)
    )
    return [_countable(row, arrival=(row.received_unix_s, row.sequence_number)) for row in newest_first][::-1]


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


def _countable(row: Any, *, arrival: ArrivalKey | None = None) -> CountablePassage:
    return CountablePassage(
        estimate=_estimate(row),
        table_digest=row.table_digest,
        values=np.frombuffer(row.features, dtype="<f4").astype(np.float32),
        arrival=arrival,
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


_INSERTED_COLUMNS = tuple(column.name for column in PASSAGES.columns if column is not _P.sequence_number)


@cache
def _insert_of(rows_count: int) -> str:
    # Handed to the driver as it stands: this is the one statement that thousands of passages a second go through.
    row = f"({', '.join('?' for _ in _INSERTED_COLUMNS)})"
    rows = ", ".join([row] * rows_count)
    return f"INSERT INTO {PASSAGES.name} ({', '.join(_INSERTED_COLUMNS)}) VALUES {rows}"  # noqa: S608 - our own names


def _passage_row(entry: PassageEntry) -> tuple[Any, ...]:
    """Return what `_insert_of` binds for a passage, in the order of its columns; a test holds the two together."""
    passage, estimate = entry.passage, entry.estimate
    return (
        passage.passage_id,
        passage.section_id,
        passage.map_version,
        passage.summary.table_digest,
        entry.values.astype("<f4", copy=False).tobytes(),
        passage.summary.duration_s,
        passage.age_s,
        int(passage.summary.quality),
        entry.received_unix_s,
        estimate.left_unix_s,
        estimate.bundle_id,
        estimate.mu,
        int(estimate.flags),
        estimate.content_digest,
        estimate.values_digest,
        estimate.expected_error_ratio,
        estimate.mu_low,
        int(estimate.at_least),
        estimate.shadow_bundle_id,
        estimate.shadow_mu,
    )
