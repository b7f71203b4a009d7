"""What the model expects of its own error.

Revision: 0002. Rows from before say nothing about it: no expected error, no lower bound, a plain estimate. On the way
down all three are dropped; older software takes a doubtful estimate for a plain one.
"""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("passages", sa.Column("expected_error_ratio", sa.REAL))
    op.add_column("passages", sa.Column("mu_low", sa.REAL))
    op.add_column("passages", sa.Column("at_least", sa.Integer, nullable=False, server_default=sa.text("0")))


def downgrade() -> None:
    op.drop_column("passages", "at_least")
    op.drop_column("passages", "mu_low")
    op.drop_column("passages", "expected_error_ratio")
