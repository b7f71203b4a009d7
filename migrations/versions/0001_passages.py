"""Passages, events and the write probe.

Revision: 0001, the first.
"""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "passages",
        sa.Column("sequence_number", sa.Integer, primary_key=True),
        sa.Column("passage_id", sa.LargeBinary, nullable=False, unique=True),
        sa.Column("section_id", sa.Text, nullable=False),
        sa.Column("map_version", sa.Text, nullable=False),
        sa.Column("table_digest", sa.Text, nullable=False),
        sa.Column("features", sa.LargeBinary, nullable=False),
        sa.Column("duration_s", sa.REAL, nullable=False),
        sa.Column("age_s", sa.REAL, nullable=False),
        sa.Column("quality", sa.Integer, nullable=False),
        sa.Column("received_unix_s", sa.REAL, nullable=False),
        sa.Column("left_unix_s", sa.REAL, nullable=False),
        sa.Column("bundle_id", sa.Text, nullable=False),
        sa.Column("mu", sa.REAL),
        sa.Column("flags", sa.Integer, nullable=False),
        sa.Column("content_digest", sa.LargeBinary, nullable=False),
        sa.Column("values_digest", sa.LargeBinary, nullable=False, unique=True),
        sa.CheckConstraint("length(passage_id) = 16", name="passage_id_length"),
        sqlite_strict=True,
    )
    op.create_index("passages_received", "passages", ["received_unix_s"])
    op.create_index("passages_section_left", "passages", ["section_id", "left_unix_s"])
    op.create_table(
        "events",
        sa.Column("sequence_number", sa.Integer, primary_key=True),
        sa.Column("at_unix_s", sa.REAL, nullable=False),
        sa.Column("kind", sa.Text, nullable=False),
        sa.Column("subject", sa.Text, nullable=False),
        sa.Column("detail", sa.Text, nullable=False),
        sqlite_strict=True,
    )
    op.create_table(
        "probes",
        sa.Column("probe_id", sa.Integer, primary_key=True),
        sa.Column("written_unix_s", sa.REAL, nullable=False),
        sa.CheckConstraint("probe_id = 1", name="single_probe"),
        sqlite_strict=True,
    )


def downgrade() -> None:
    op.drop_table("probes")
    op.drop_table("events")
    op.drop_table("passages")
