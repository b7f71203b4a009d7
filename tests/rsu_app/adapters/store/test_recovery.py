from __future__ import annotations

import asyncio

import pytest

from roadgrip.errors import StoreError
from roadgrip.ledger import Action
from rsu_app.adapters.store import open_store
from rsu_app.adapters.store.recovery import KEPT_COUNT, damage, move_aside
from rsu_app.adapters.store.schema import REVISION
from tests.rsu_app.adapters.store.stories import make_entry


@pytest.fixture
def path(tmp_path):
    return tmp_path / "passages.db"


def fill(path, count=50):
    async def story():
        store = open_store(path)
        await asyncio.gather(*(store.append(make_entry(seed)) for seed in range(count)))
        await store.close()

    asyncio.run(story())


def count_and_notes(path):
    async def story():
        store = open_store(path)
        counts = await store.counts()
        await store.append(make_entry(1000))
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
