"""The migrations themselves, for a process that runs them and ends: `python -m rsu_app.adapters.store.migrating FILE`.

What went wrong is its last line of standard output, in JSON, so that whoever started it can say the same.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from alembic import command
from alembic.util import CommandError

from roadgrip.errors import StoreError
from rsu_app.adapters.store.connection import only_transaction, writing_engine
from rsu_app.adapters.store.migration import SchemaState, alembic_config, check


def migrate(database_path: Path) -> SchemaState:
    """Return where the database stands after all migrations ran, in one transaction.

    Raises:
        StoreError: A migration failed.
    """
    doing = f"migrating {database_path}"
    try:
        with only_transaction(writing_engine(database_path), doing=doing) as connection:
            config = alembic_config()
            config.attributes["connection"] = connection
            command.upgrade(config, "head")
    except CommandError as error:
        raise StoreError(f"{doing}: {error}") from error
    return check(database_path)


def main(database_path: Path) -> int:
    """Return the exit code after migrating: 0, or 1 with the problem on standard output."""
    try:
        migrate(database_path)
    except StoreError as error:
        sys.stdout.write(json.dumps({"kind": type(error).__name__, "problem": str(error)}) + "\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
