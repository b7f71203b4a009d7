"""The passages on disk: SQLite, one writer thread, acknowledgement after the commit. The one door to SQL."""

from rsu_app.adapters.store.migration import SchemaState, check, upgrade
from rsu_app.adapters.store.recovery import integrity_problems
from rsu_app.adapters.store.sqlite import SqlitePassageStore, newest_received_unix_s, open_or_standby, open_store
from rsu_app.adapters.store.standby import StandbyStore
from rsu_app.adapters.store.writer import WriterLimits

__all__ = [
    "SchemaState",
    "SqlitePassageStore",
    "StandbyStore",
    "WriterLimits",
    "check",
    "integrity_problems",
    "newest_received_unix_s",
    "open_or_standby",
    "open_store",
    "upgrade",
]
