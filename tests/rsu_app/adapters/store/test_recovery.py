from __future__ import annotations

import asyncio
import errno
import shutil
import sqlite3
from contextlib import closing

import pytest

from roadgrip.errors import StoreDamagedError, StoreError
from roadgrip.ledger import Action
from rsu_app.adapters.store import in_use, open_or_standby, open_store
from rsu_app.adapters.store.connection import make_log_last, only_transaction, writing_engine
from rsu_app.adapters.store.recovery import KEPT_COUNT, damage, keep_damaged_log, move_aside
from rsu_app.adapters.store.schema import REVISION
from tests.rsu_app.adapters.store.stories import make_entry


@pytest.fixture
def path(tmp_path):
    return tmp_path / "passages.db"


def fill(path, count=50):
    async def story():
        store = open_store(path)
        await asyncio.gather(*(store.append([make_entry(seed)]) for seed in range(count)))
        await store.close()

    asyncio.run(story())


def count_and_notes(path):
    async def story():
        store = open_store(path)
        counts = await store.counts()
        await store.append([make_entry(1000)])
        await store.close()
        return counts.passages_count, store.notes

    return asyncio.run(story())


def test_a_sound_database_is_left_alone(path):
    fill(path)
    assert damage(path) is None
    assert count_and_notes(path) == (50, ())


@pytest.mark.parametrize("spoil", ["header", "middle", "text"])
def test_a_damaged_database_is_moved_aside_and_a_fresh_one_begun(path, spoil):
    fill(path, 200)
    content = bytearray(path.read_bytes())
    if spoil == "header":
        content[:100] = b"\x00" * 100
    elif spoil == "middle":
        content[4096 * 5 : 4096 * 40] = b"\xa5" * (4096 * 35)
    else:
        content = bytearray(b"this was a database once\n" * 1000)
    path.write_bytes(content)
    count, notes = count_and_notes(path)
    assert count == 0
    assert "damaged" in notes[0]
    [kept] = path.parent.glob("passages.db.damaged-*")
    assert kept.read_bytes() == content
    assert kept.name in notes[0]


def first_entry(path):
    async def story():
        store = open_store(path)
        [*_, entry] = await store.ledger(limit_count=100)
        await store.close()
        return entry

    return asyncio.run(story())


def test_the_ledger_begun_after_damage_says_so_and_names_the_old_file(path):
    path.write_text("this was a database once\n" * 1000)
    entry = first_entry(path)
    [kept] = path.parent.glob("passages.db.damaged-*")
    assert (entry.sequence_number, entry.action) == (1, Action.LEDGER_BEGUN)
    assert "damaged" in entry.reason
    assert entry.evidence == {"damaged_database": kept.name}


def test_a_ledger_begun_later_than_the_damage_was_found_still_names_the_old_file(path):
    path.write_text("this was a database once\n" * 1000)
    moved_to = move_aside(path, now_unix_s=0.0)
    entry = first_entry(path)
    assert (entry.reason, entry.evidence) == ("a new database", {"damaged_database": moved_to.name})


def test_the_ledger_goes_on_through_restarts(path):
    first = first_entry(path)
    assert first_entry(path) == first


def test_an_empty_file_is_a_fresh_database(path):
    path.touch()
    count, notes = count_and_notes(path)
    assert count == 0
    assert notes == (f"the database was migrated from revision None to {REVISION}",)


def test_damaged_copies_do_not_pile_up(path):
    for number in range(5):
        path.write_text(f"damage {number}")
        path.with_name("passages.db-wal").write_text("its log")
        moved_to = move_aside(path, now_unix_s=0.0)
        assert moved_to.read_text() == f"damage {number}"
        assert moved_to.with_name(moved_to.name + "-wal").exists()
    left = sorted(path.parent.iterdir())
    assert len(left) == 2 * KEPT_COUNT
    assert {file.read_text() for file in left if not file.name.endswith("-wal")} == {"damage 3", "damage 4"}


def test_what_cannot_be_examined_is_an_error_not_damage(tmp_path):
    with pytest.raises(StoreError, match="examining"):
        damage(tmp_path)


@pytest.fixture
def killed_path(path, tmp_path):
    """A database as a unit leaves it that is killed: with a log of thirty commits."""

    async def story():
        folder = tmp_path / "alive"
        folder.mkdir()
        store = open_store(folder / path.name)
        for seed in range(30):
            await store.append([make_entry(seed)])
        for name in (path.name, f"{path.name}-wal"):
            shutil.copy(folder / name, tmp_path)
        await store.close()

    asyncio.run(story())
    return path


def log_of(path):
    return path.with_name(f"{path.name}-wal")


def spoil(path, *, at_byte):
    content = bytearray(path.read_bytes())
    content[at_byte] ^= 1
    path.write_bytes(content)
    return bytes(content)


def test_a_log_that_is_whole_is_left_alone(killed_path):
    assert keep_damaged_log(killed_path, now_unix_s=0.0) is None
    assert count_and_notes(killed_path) == (30, ())


@pytest.mark.parametrize("at_byte", [0, 20, 32 + 4 * 4120 + 2000])
def test_of_a_log_that_is_spoilt_a_copy_is_kept_and_what_can_be_read_stays(killed_path, at_byte):
    spoilt = spoil(log_of(killed_path), at_byte=at_byte)
    count, notes = count_and_notes(killed_path)
    assert count < 30
    [kept] = killed_path.parent.glob("passages.db.damaged-*")
    assert kept.read_bytes() == spoilt
    assert kept.name in notes[0]


def test_a_commit_that_was_interrupted_is_dropped_without_a_word(killed_path):
    log = log_of(killed_path)
    log.write_bytes(log.read_bytes()[:-1000])
    assert count_and_notes(killed_path) == (29, ())


def test_a_database_that_is_damaged_in_service_is_begun_afresh(path):
    async def story():
        store = open_or_standby(path)
        await asyncio.gather(*(store.append([make_entry(seed)]) for seed in range(50)))
        size_bytes = path.stat().st_size
        with path.open("r+b") as file:
            file.write(b"this was a database once\n" * (size_bytes // 25))
        log_of(path).write_bytes(b"")
        with pytest.raises(StoreDamagedError):
            await store.counts()
        # Opened a moment ago, it is left alone for a while: what is damaged again and again must not wear out the disk.
        with pytest.raises(StoreError):
            await store.counts()
        await store.close()

    asyncio.run(story())
    assert count_and_notes(path)[0] == 0


def test_a_log_is_written_anew_before_anything_is_built_on_it(killed_path):
    log = log_of(killed_path)
    before = (log.read_bytes(), log.stat().st_mtime_ns)
    with closing(sqlite3.connect(killed_path)) as connection:
        make_log_last(connection)
        assert log.read_bytes() == before[0]
        assert log.stat().st_mtime_ns > before[1]
        assert not connection.in_transaction


def files_of(path):
    return path.read_bytes(), log_of(path).read_bytes()


@pytest.mark.parametrize("examine", [damage, lambda path: keep_damaged_log(path, now_unix_s=0.0)])
def test_to_look_at_a_database_does_not_work_its_log_into_it(killed_path, examine):
    before = files_of(killed_path)
    assert examine(killed_path) is None
    assert files_of(killed_path) == before


def test_a_log_that_cannot_be_made_last_is_not_worked_into_the_database(killed_path, monkeypatch):
    def refuse(_):
        raise OSError(errno.EIO, "as after a bad block")

    before = files_of(killed_path)
    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", refuse)
        with pytest.raises(StoreError), only_transaction(writing_engine(killed_path), doing="writing"):
            pass
    assert files_of(killed_path) == before
    assert count_and_notes(killed_path) == (30, ())


def test_a_log_is_written_anew_before_asking_who_uses_a_database_works_it_in(killed_path, monkeypatch):
    log, made_last = log_of(killed_path), []
    content, written_ns = log.read_bytes(), log.stat().st_mtime_ns

    def note(descriptor):
        made_last.append((log.read_bytes() == content, log.stat().st_mtime_ns > written_ns))

    monkeypatch.setattr("os.fsync", note)
    assert not in_use(killed_path)
    assert made_last == [(True, True)]
    assert not log.exists()


def test_a_spoilt_log_is_told_once(killed_path):
    spoil(log_of(killed_path), at_byte=20)
    assert count_and_notes(killed_path)[1]
    assert count_and_notes(killed_path)[1] == ()
