"""The tables as this software reads and writes them.

The migrations make the same tables in their own words; a test compares both.
"""

from __future__ import annotations

from sqlalchemy import DDL, CheckConstraint, Column, Index, Integer, LargeBinary, MetaData, Table, Text, event, text
from sqlalchemy.types import REAL

REVISION = "0003"
"""The migration after which the database looks like this."""

METADATA = MetaData()

PASSAGES = Table(
    "passages",
    METADATA,
    # In the order of arrival: what pruning goes by when the wall clock cannot be trusted.
    Column("sequence_number", Integer, primary_key=True),
    Column("passage_id", LargeBinary, nullable=False, unique=True),
    Column("section_id", Text, nullable=False),
    Column("map_version", Text, nullable=False),
    Column("table_digest", Text, nullable=False),
    # 32-bit little-endian floats in the order of the feature table that the digest names.
    Column("features", LargeBinary, nullable=False),
    Column("duration_s", REAL, nullable=False),
    Column("age_s", REAL, nullable=False),
    Column("quality", Integer, nullable=False),
    Column("received_unix_s", REAL, nullable=False),
    Column("left_unix_s", REAL, nullable=False),
    Column("bundle_id", Text, nullable=False),
    Column("mu", REAL),
    Column("flags", Integer, nullable=False),
    Column("content_digest", LargeBinary, nullable=False),
    # Unique: the same values under another passage id are a replay, for as long as the first is kept.
    Column("values_digest", LargeBinary, nullable=False, unique=True),
    # What the model expects of its own error; NULL where it says nothing.
    Column("expected_error_ratio", REAL),
    Column("mu_low", REAL),
    # 1: the passage only says that the friction is at least `mu_low`.
    Column("at_least", Integer, nullable=False, server_default=text("0")),
    # The bundle that was asked beside the live one and what it said; NULL where none was, or it had no answer.
    Column("shadow_bundle_id", Text),
    Column("shadow_mu", REAL),
    CheckConstraint("length(passage_id) = 16", name="passage_id_length"),
    Index("passages_received", "received_unix_s"),
    Index("passages_section_left", "section_id", "left_unix_s"),
    sqlite_strict=True,
)

LEDGER_LIMIT_COUNT = 100_000
"""Entries of the ledger that are kept; the oldest go. The trigger that keeps the others says it once more."""

LEDGER = Table(
    "ledger",
    METADATA,
    Column("sequence_number", Integer, primary_key=True),
    Column("at_unix_s", REAL, nullable=False),
    Column("actor", Text, nullable=False),
    Column("action", Text, nullable=False),
    Column("subject", Text, nullable=False),
    Column("reason", Text, nullable=False),
    # An object of names and texts.
    Column("evidence_json", Text, nullable=False),
    Column("previous_hash", Text, nullable=False),
    Column("entry_hash", Text, nullable=False),
    sqlite_strict=True,
)

# They keep a slip from the ledger, not a person who means it: that one can drop them, and only the chain tells.
LEDGER_TRIGGERS = (
    # Also what INSERT OR REPLACE comes by, which would fire neither of the other two.
    """
    CREATE TRIGGER ledger_only_grows BEFORE INSERT ON ledger
    WHEN NEW.sequence_number <> coalesce((SELECT max(sequence_number) FROM ledger), 0) + 1
      OR NEW.previous_hash <> coalesce(
        (SELECT entry_hash FROM ledger ORDER BY sequence_number DESC LIMIT 1),
        '0000000000000000000000000000000000000000000000000000000000000000'
      )
    BEGIN SELECT RAISE(ABORT, 'an entry of the ledger follows the newest one'); END
    """,
    """
    CREATE TRIGGER ledger_never_changes BEFORE UPDATE ON ledger
    BEGIN SELECT RAISE(ABORT, 'an entry of the ledger is never changed'); END
    """,
    """
    CREATE TRIGGER ledger_keeps_the_newest BEFORE DELETE ON ledger
    WHEN OLD.sequence_number > (SELECT max(sequence_number) FROM ledger) - 100000
    BEGIN SELECT RAISE(ABORT, 'the newest entries of the ledger are never deleted'); END
    """,
)
for _trigger in LEDGER_TRIGGERS:
    event.listen(LEDGER, "after_create", DDL(_trigger))  # type: ignore[no-untyped-call]

PROBES = Table(
    "probes",
    METADATA,
    # One row that readiness overwrites to see that a write reaches the disk.
    Column("probe_id", Integer, primary_key=True),
    Column("written_unix_s", REAL, nullable=False),
    CheckConstraint("probe_id = 1", name="single_probe"),
    sqlite_strict=True,
)
