"""Entries of the ledger to rows and back; every statement about it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import Connection, Row, delete, insert, select

from roadgrip.ledger import WENT_LIVE, Action, LedgerEntry, LedgerError, entry_after
from rsu_app.adapters.store.schema import LEDGER, LEDGER_LIMIT_COUNT

_L = LEDGER.c


def append_entry(
    connection: Connection,
    *,
    at_unix_s: float,
    actor: str,
    action: Action,
    subject: str,
    reason: str,
    evidence: Mapping[str, str] | None = None,
) -> LedgerEntry:
    """Store the entry that follows the newest one and return it; the oldest beyond the limit goes.

    The transaction must have begun with the write lock, or the chain could fork.

    Raises:
        LedgerError: The newest entry cannot be read.
    """
    entry = entry_after(
        head(connection),
        # SQLite gives a negative zero back as zero, and the hash would not be its own any more.
        at_unix_s=round(at_unix_s, 3) + 0.0,
        actor=actor,
        action=action,
        subject=subject,
        reason=reason,
        evidence=evidence,
    )
    row = {
        "sequence_number": entry.sequence_number,
        "at_unix_s": entry.at_unix_s,
        "actor": entry.actor,
        "action": entry.action.value,
        "subject": entry.subject,
        "reason": entry.reason,
        "evidence_json": json.dumps(dict(entry.evidence)),
        "previous_hash": entry.previous_hash,
        "entry_hash": entry.entry_hash,
    }
    connection.execute(insert(LEDGER).values(row))
    connection.execute(delete(LEDGER).where(_L.sequence_number <= entry.sequence_number - LEDGER_LIMIT_COUNT))
    return entry


def head(connection: Connection) -> LedgerEntry | None:
    """Return the newest entry; None while there is none.

    Raises:
        LedgerError: It cannot be read.
    """
    newest = newest_entries(connection, limit_count=1)
    return newest[0] if newest else None


def newest_entries(connection: Connection, *, limit_count: int) -> list[LedgerEntry]:
    """Return entries, newest first.

    Raises:
        LedgerError: One of them cannot be read.
    """
    rows = connection.execute(select(LEDGER).order_by(_L.sequence_number.desc()).limit(limit_count))
    return [entry_of(row) for row in rows]


def rows_after(connection: Connection, *, sequence_number: int, limit_count: int) -> Sequence[Row[Any]]:
    """Return rows that follow a number, oldest first."""
    following = select(LEDGER).where(_L.sequence_number > sequence_number)
    return connection.execute(following.order_by(_L.sequence_number).limit(limit_count)).fetchall()


def live_bundle_id(connection: Connection) -> str:
    """Return the bundle that is live by the ledger's newest word on it; empty for none, and without a word."""
    went_live = select(_L.subject).where(_L.action.in_([action.value for action in WENT_LIVE]))
    return connection.execute(went_live.order_by(_L.sequence_number.desc()).limit(1)).scalar_one_or_none() or ""


def entry_of(row: Any) -> LedgerEntry:
    """Return the entry that a row holds; whether it is true is for `roadgrip.ledger.chain_problems` to say.

    Raises:
        LedgerError: It holds none.
    """
    try:
        evidence = {str(name): str(text) for name, text in json.loads(row.evidence_json).items()}
        return LedgerEntry(
            sequence_number=row.sequence_number,
            at_unix_s=row.at_unix_s,
            actor=row.actor,
            action=Action(row.action),
            subject=row.subject,
            reason=row.reason,
            evidence=evidence,
            previous_hash=row.previous_hash,
            entry_hash=row.entry_hash,
        )
    except (ValueError, AttributeError, RecursionError) as error:
        raise LedgerError(f"entry {row.sequence_number} cannot be read: {error}") from error
