"""What a visit does to the unit itself: its cache, its disk, its start and its log."""

import errno
import logging
import os
import shutil
import subprocess
import sys

import pytest

from rsu_app.rollout_ports import UpdateReason
from tests.rsu_app.adapters.updates.sites import content_of

# The unit's own disk -------------------------------------------------------------------------------------------------

CACHED = ["timestamp.json", "snapshot.json", "targets.json", "root.json", "root_history/1.root.json"]


@pytest.mark.parametrize("name", [*CACHED, "root_history/2.root.json", "root_history", "."])
@pytest.mark.parametrize("damage", ["garbage", "empty", "a folder", "missing"])
def test_a_damaged_cache_does_not_stand_in_the_way(running, name, damage):
    running.repository.rotate("timestamp")
    running.repository.release(running.bundle(0.6), sequence_number=2)
    assert running.fetched(newer_than=1)
    path = running.cache_folder / name
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()
    match damage:
        case "garbage":
            path.write_bytes(b'{"signed": \xff\0')
        case "empty":
            path.write_bytes(b"")
        case "a folder":
            (path / "with something in it").mkdir(parents=True)
        case _:
            pass
    running.repository.release(running.bundle(0.7), sequence_number=3)
    assert running.fetched(newer_than=1).release.sequence_number == 3
    assert running.fetch(newer_than=3) is None


def test_without_its_cache_a_unit_still_knows_the_newest_release(running):
    # The metadata's own memory is gone with the cache; what the state says is not.
    old = running.folder / "old"
    shutil.copytree(running.repository.folder, old)
    running.repository.release(running.bundle(0.6), sequence_number=2)
    assert running.fetch(newer_than=2) is None
    shutil.rmtree(running.cache_folder)
    assert running.reason(running.source(str(old)), newer_than=2) is UpdateReason.DOWNGRADE


def test_what_interrupted_visits_leave_in_the_cache_is_removed(running):
    for number in range(3):
        (running.cache_folder / f"tmp{number}").write_bytes(b"half")
    assert running.fetch(newer_than=1) is None
    assert not list(running.cache_folder.glob("tmp*"))


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS])
@pytest.mark.parametrize("place", ["the cache", "the files"])
def test_a_disk_that_takes_nothing_is_told_of(running, monkeypatch, number, place):
    running.repository.release(running.bundle(0.6), sequence_number=2)

    def fail(*_args, **_options):
        raise OSError(number, os.strerror(number))

    name = "os.replace" if place == "the cache" else "tuf.ngclient.updater.shutil.copyfileobj"
    with monkeypatch.context() as patched:
        patched.setattr(name, fail)
        refusal = running.refusal(newer_than=1)
    assert refusal.reason is UpdateReason.NO_ROOM
    assert os.strerror(number) in refusal.detail
    assert running.runs_on()
    assert running.fetched(newer_than=1).release.sequence_number == 2


def test_a_full_disk_does_not_cost_the_cache(running, monkeypatch):
    kept = content_of(running.cache_folder)

    def fail(*_args, **_options):
        raise OSError(errno.ENOSPC, "full")

    with monkeypatch.context() as patched:
        patched.setattr("os.replace", fail)
        assert running.reason(newer_than=1) is UpdateReason.NO_ROOM
    assert content_of(running.cache_folder).keys() >= kept.keys() - {"root.json"}


# Start-up and logs ---------------------------------------------------------------------------------------------------


def test_a_unit_that_starts_does_not_wait_for_python_tuf():
    program = "import sys, rsu_app.adapters.updates; sys.exit(any(m.split('.')[0] == 'tuf' for m in sys.modules))"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_a_visit_says_nothing_below_a_warning(site, caplog):
    caplog.set_level(logging.DEBUG)
    site.repository.release(site.bundle(), sequence_number=1)
    assert site.fetched()
    assert caplog.records == []
