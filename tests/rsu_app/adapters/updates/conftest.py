"""A unit that trusts a repository, and one that runs what it found there."""

import os

import pytest

from tests.rsu_app.adapters.updates.sites import UpdateSite


@pytest.fixture(autouse=True)
def hurried_disk(monkeypatch):
    """Let nobody wait for the disk: that it is waited for where it must be is seen by the power cuts of test_kill."""
    monkeypatch.setattr(os, "fsync", lambda _descriptor: None)


@pytest.fixture
def site(tmp_path):
    return UpdateSite(tmp_path)


@pytest.fixture
def running(site):
    """Return a site whose unit runs release 1, as every refusal has to leave it."""
    site.run_first_release()
    return site
