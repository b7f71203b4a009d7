"""The ledger in place of events, and what a second bundle said of each passage.

Revision: 0003. Every event becomes an entry of the ledger, in order, by the actor "unit" and without evidence. On the
way down entries become events again: who did it, the evidence and the hashes are dropped, and so is what the second
bundle said; a way up after that makes a new chain.
"""

import hashlib
import json
import math
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

GENESIS_HASH = "0" * 64
TEXT_LIMIT_CHARS = 2_000
KINDS = {"model_live": "live"}
"""What older software called an action; whatever else stands there was an action before a way down."""

TRIGGERS = (
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


def upgrade() -> None:
    ledger = op.create_table(
        "ledger",
        sa.Column("sequence_number", sa.Integer, primary_key=True),
        sa.Column("at_unix_s", sa.REAL, nullable=False),
        sa.Column("actor", sa.Text, nullable=False),
        sa.Column("action", sa.Text, nullable=False),
        sa.Column("subject", sa.Text, nullable=False),
        sa.Column("reason", sa.Text, nullable=False),
        sa.Column("evidence_json", sa.Text, nullable=False),
        sa.Column("previous_hash", sa.Text, nullable=False),
        sa.Column("entry_hash", sa.Text, nullable=False),
        sqlite_strict=True,
    )
    for trigger in TRIGGERS:
        op.execute(sa.text(trigger))
    chain = entries_of(op.get_bind().execute(sa.select(events()).order_by("sequence_number")).fetchall())
    if chain:
        op.bulk_insert(ledger, chain)
    op.drop_table("events")
    op.add_column("passages", sa.Column("shadow_bundle_id", sa.Text))
    op.add_column("passages", sa.Column("shadow_mu", sa.REAL))


def downgrade() -> None:
    op.drop_column("passages", "shadow_mu")
    op.drop_column("passages", "shadow_bundle_id")
    op.create_table(
        "events",
        sa.Column("sequence_number", sa.Integer, primary_key=True),
        sa.Column("at_unix_s", sa.REAL, nullable=False),
        sa.Column("kind", sa.Text, nullable=False),
        sa.Column("subject", sa.Text, nullable=False),
        sa.Column("detail", sa.Text, nullable=False),
        sqlite_strict=True,
    )
    action = sa.column("action", sa.Text)
    said = sa.select(
        sa.column("sequence_number"),
        sa.column("at_unix_s"),
        sa.case({actions: kind for kind, actions in KINDS.items()}, value=action, else_=action),
        sa.column("subject"),
        sa.column("reason"),
    )
    op.execute(sa.insert(events()).from_select(events().c.keys(), said.select_from(sa.table("ledger"))))
    # Triggers go with their table.
    op.drop_table("ledger")


def events() -> sa.TableClause:
    return sa.table(
        "events",
        sa.column("sequence_number", sa.Integer),
        sa.column("at_unix_s", sa.REAL),
        sa.column("kind", sa.Text),
        sa.column("subject", sa.Text),
        sa.column("detail", sa.Text),
    )


def entries_of(rows: Sequence[Any]) -> list[dict[str, Any]]:
    """Return the rows of events as rows of a ledger, each with the hash of the one before it."""
    entries: list[dict[str, Any]] = []
    previous_hash = GENESIS_HASH
    for number, row in enumerate(rows, start=1):
        entry = {
            "sequence_number": number,
            # Zero is added for a negative zero, which would come back from the table as another text.
            "at_unix_s": round(row.at_unix_s, 3) + 0.0 if math.isfinite(row.at_unix_s) else 0.0,
            "actor": "unit",
            "action": KINDS.get(row.kind, row.kind),
            "subject": row.subject,
            "reason": row.detail[:TEXT_LIMIT_CHARS],
            "evidence_json": "{}",
            "previous_hash": previous_hash,
        }
        said = [
            entry["sequence_number"],
            f"{entry['at_unix_s']:.3f}",
            entry["actor"],
            entry["action"],
            entry["subject"],
            entry["reason"],
            {},
            entry["previous_hash"],
        ]
        text = json.dumps(said, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
        previous_hash = hashlib.sha256(text.encode()).hexdigest()
        entries.append({**entry, "entry_hash": previous_hash})
    return entries
