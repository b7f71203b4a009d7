"""The passages on disk: SQLite, one writer thread, acknowledgement after the commit. The one door to SQL."""

from rsu_app.adapters.store.migration import SchemaState, check, upgrade
from rsu_app.adapters.store.sqlite import SqlitePassageStore, open_store
from rsu_app.adapters.store.writer import WriterLimits

__all__ = ["SchemaState", "SqlitePassageStore", "WriterLimits", "check", "open_store", "upgrade"]
