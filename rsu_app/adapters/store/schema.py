"""The tables as this software reads and writes them.

The migrations make the same tables in their own words; a test compares both.
"""

from __future__ import annotations

from sqlalchemy import CheckConstraint, Column, Index, Integer, LargeBinary, MetaData, Table, Text, text
from sqlalchemy.types import REAL

REVISION = "0002"
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
    CheckConstraint("length(passage_id) = 16", name="passage_id_length"),
    Index("passages_received", "received_unix_s"),
    Index("passages_section_left", "section_id", "left_unix_s"),
    sqlite_strict=True,
)

EVENTS = Table(
    "events",
    METADATA,
    Column("sequence_number", Integer, primary_key=True),
    Column("at_unix_s", REAL, nullable=False),
    Column("kind", Text, nullable=False),
    Column("subject", Text, nullable=False),
    Column("detail", Text, nullable=False),
    sqlite_strict=True,
)

PROBES = Table(
    "probes",
    METADATA,
    # One row that readiness overwrites to see that a write reaches the disk.
    Column("probe_id", Integer, primary_key=True),
    Column("written_unix_s", REAL, nullable=False),
    CheckConstraint("probe_id = 1", name="single_probe"),
    sqlite_strict=True,
)
