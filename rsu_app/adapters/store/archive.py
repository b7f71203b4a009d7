"""The database file as it is read beside a unit: its ledger, and its passages without what tells vehicles apart.

Everything is read in batches, each in a transaction of its own: however long a reading takes, memory stays bounded and
the unit's log file can be emptied in between.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from roadgrip.errors import StoreError
from roadgrip.ledger import LedgerEntry, LedgerError, chain_problems
from roadgrip.passage_export import ExportedPassage
from rsu_app.adapters.store import export_rows, ledger_rows, rows
from rsu_app.adapters.store.connection import only_transaction, reading_engine
from rsu_app.adapters.store.export_rows import Place, Wanted
from rsu_app.adapters.store.migration import check
from rsu_app.adapters.store.schema import LEDGER_LIMIT_COUNT

ENTRIES_BATCH_COUNT = 1_000
PASSAGES_BATCH_COUNT = 500


@dataclass(frozen=True, slots=True)
class LedgerVerdict:
    """Whether a ledger holds together.

    Attributes:
        entries_count: Entries that are there.
        head_hash: Of the newest; empty without any.
        problems: What is wrong, a line each.
    """

    entries_count: int
    head_hash: str
    problems: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Lineage:
    """What a database says about itself at one moment.

    Attributes:
        bundle_id: The live bundle by the ledger; empty for none.
        ledger_hash: Head of the ledger; empty before its first entry.
        newest_received_unix_s: When the newest passage was received; zero without any.
    """

    bundle_id: str
    ledger_hash: str
    newest_received_unix_s: float


def newest_entries(database_path: Path, *, limit_count: int) -> list[LedgerEntry]:
    """Return the newest entries of the ledger, newest first.

    Raises:
        StoreError: There is no database of this software's schema, or it cannot be read.
        LedgerError: An entry is none.
    """
    _check_readable(database_path)
    with only_transaction(reading_engine(database_path), doing=f"reading {database_path}") as connection:
        return ledger_rows.newest_entries(connection, limit_count=limit_count)


def ledger_verdict(database_path: Path, *, known_heads: Collection[str] = ()) -> LedgerVerdict:
    """Return whether the whole ledger holds together.

    Args:
        database_path: The file.
        known_heads: Hashes that were its head at some time, as told elsewhere.

    Raises:
        StoreError: There is no database of this software's schema, or it cannot be read.
    """
    _check_readable(database_path)
    problems: dict[str, None] = {}
    missing_heads = dict.fromkeys(known_heads)
    first_number, entries_count, last = 0, 0, None
    for batch in _entry_batches(database_path, problems):
        # With the last one before it, or what joins two batches would go unseen.
        problems |= dict.fromkeys(chain_problems([*([last] if last else []), *batch]))
        for entry in batch:
            missing_heads.pop(entry.entry_hash, None)
        first_number = first_number or batch[0].sequence_number
        entries_count, last = entries_count + len(batch), batch[-1]
    if last is not None and first_number > 1 and last.sequence_number - first_number + 1 < LEDGER_LIMIT_COUNT:
        problems[f"the entries before {first_number} are missing, and it was not the budget that took them"] = None
    problems |= dict.fromkeys(chain_problems([], known_heads=missing_heads))
    return LedgerVerdict(entries_count, last.entry_hash if last else "", tuple(problems))


def lineage(database_path: Path) -> Lineage:
    """Return what the database says about itself.

    Raises:
        StoreError: There is no database of this software's schema, or it cannot be read.
        LedgerError: The newest entry of the ledger is none.
    """
    _check_readable(database_path)
    with only_transaction(reading_engine(database_path), doing=f"reading {database_path}") as connection:
        newest = ledger_rows.head(connection)
        return Lineage(
            bundle_id=ledger_rows.live_bundle_id(connection),
            ledger_hash="" if newest is None else newest.entry_hash,
            newest_received_unix_s=rows.newest_received_unix_s(connection),
        )


def wanted_count(database_path: Path, wanted: Wanted) -> int:
    """Return how many passages an export will hold.

    Raises:
        StoreError: It cannot be read.
    """
    with only_transaction(reading_engine(database_path), doing=f"reading {database_path}") as connection:
        return export_rows.wanted_count(connection, wanted)


def exported_passages(database_path: Path, wanted: Wanted) -> Iterator[ExportedPassage]:
    """Yield the passages of an export by section, and within one in the order in which vehicles left it.

    Raises:
        StoreError: It cannot be read.
    """
    after: Place | None = None
    while True:
        with only_transaction(reading_engine(database_path), doing=f"reading {database_path}") as connection:
            batch = export_rows.passages_after(connection, wanted, after=after, limit_count=PASSAGES_BATCH_COUNT)
        yield from (passage for _, passage in batch)
        if len(batch) < PASSAGES_BATCH_COUNT:
            return
        after = batch[-1][0]


def _entry_batches(database_path: Path, problems: dict[str, None]) -> Iterator[list[LedgerEntry]]:
    """Yield entries that can be read, oldest first, never an empty batch; what cannot goes to the problems."""
    number, full = 0, True
    while full:
        with only_transaction(reading_engine(database_path), doing=f"reading {database_path}") as connection:
            found = ledger_rows.rows_after(connection, sequence_number=number, limit_count=ENTRIES_BATCH_COUNT)
        entries = []
        for row in found:
            number = row.sequence_number
            try:
                entries.append(ledger_rows.entry_of(row))
            except LedgerError as error:
                problems[str(error)] = None
        if entries:
            yield entries
        full = len(found) == ENTRIES_BATCH_COUNT


def _check_readable(database_path: Path) -> None:
    state = check(database_path)
    if not database_path.exists():
        raise StoreError(f"{database_path} does not exist yet; `roadgrip-rsu serve` makes it")
    if not state.up_to_date:
        raise StoreError(
            f"{database_path} is at revision {state.current}, this software reads {state.expected}; "
            "`roadgrip-rsu db upgrade` brings an older one there"
        )
