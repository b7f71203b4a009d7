"""The passages on disk: SQLite, one writer thread, acknowledgement after the commit. The one door to SQL."""

from rsu_app.adapters.store.archive import (
    LedgerVerdict,
    Lineage,
    exported_passages,
    ledger_verdict,
    lineage,
    newest_entries,
    wanted_count,
)
from rsu_app.adapters.store.copying import copy_database, in_use, note_restored
from rsu_app.adapters.store.export_rows import Wanted
from rsu_app.adapters.store.migration import SchemaState, check, upgrade
from rsu_app.adapters.store.recovery import integrity_problems, moved_aside, set_aside
from rsu_app.adapters.store.sqlite import SqlitePassageStore, newest_received_unix_s, open_or_standby, open_store
from rsu_app.adapters.store.standby import StandbyStore
from rsu_app.adapters.store.writer import WriterLimits

__all__ = [
    "LedgerVerdict",
    "Lineage",
    "SchemaState",
    "SqlitePassageStore",
    "StandbyStore",
    "Wanted",
    "WriterLimits",
    "check",
    "copy_database",
    "exported_passages",
    "in_use",
    "integrity_problems",
    "ledger_verdict",
    "lineage",
    "moved_aside",
    "newest_entries",
    "newest_received_unix_s",
    "note_restored",
    "open_or_standby",
    "open_store",
    "set_aside",
    "upgrade",
    "wanted_count",
]
