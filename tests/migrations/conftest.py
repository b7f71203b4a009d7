import pytest

from rsu_app.adapters.store.migrating import migrate


@pytest.fixture
def migrations_run_here(monkeypatch):
    # What becomes of the rows does not depend on which process migrates them, and one of its own takes seconds.
    monkeypatch.setattr("rsu_app.adapters.store.migration._migrate_apart", migrate)
