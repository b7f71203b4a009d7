from __future__ import annotations

import asyncio
import gzip
import hashlib
import io
import json
import sqlite3
import tarfile
from contextlib import closing
from pathlib import Path

import pytest
from alembic import command
from typer.testing import CliRunner

import rsu_app.__main__ as door
import rsu_app.cli.main as program
from roadgrip.ledger import Action
from roadgrip.section_file import section_to_json
from roadgrip.sections import read_section
from rsu_app.adapters.http.control import control_socket
from rsu_app.adapters.store import copying, newest_entries, open_store
from rsu_app.adapters.store.connection import writing_engine
from rsu_app.adapters.store.copying import copy_database, in_use
from rsu_app.adapters.store.migration import alembic_config
from rsu_app.adapters.store.schema import REVISION
from rsu_app.adapters.updates import FolderShelf
from rsu_app.domain.rollout import RolloutState
from tests.rsu_app.adapters.store.stories import make_entry


@pytest.fixture
def config(tmp_path: Path) -> Path:
    folder = tmp_path / "unit"
    folder.mkdir()
    (folder / "bend.json").write_text(section_to_json(read_section("s-turn")), encoding="utf-8")
    path = folder / "rsu.toml"
    path.write_text(
        '[database]\npath = "state/rsu.sqlite3"\n[export]\nunit_name = "fv27-bend"\n[[sections]]\nfile = "bend.json"\n',
        encoding="utf-8",
    )
    return path


@pytest.fixture
def database(config: Path) -> Path:
    return config.parent / "state" / "rsu.sqlite3"


@pytest.fixture
def shelf(database: Path) -> Path:
    return database.parent / "roadgrip-models"


def kept(database, seeds):
    """Keep passages in a database that nobody uses afterwards."""

    async def story():
        store = open_store(database)
        await asyncio.gather(*(store.append([make_entry(seed)]) for seed in seeds))
        await store.close()

    database.parent.mkdir(exist_ok=True)
    asyncio.run(story())


def passages_count(database):
    with closing(sqlite3.connect(database)) as connection:
        return connection.execute("SELECT count(*) FROM passages").fetchone()[0]


def done(config, *words):
    """Run a command that must succeed and return what it says to a machine."""
    result = CliRunner().invoke(program.app, [*map(str, words), "--config", str(config), "--json"])
    assert result.exit_code == 0, (result.output, result.exception)
    return json.loads(result.stdout)


def refused(config, monkeypatch, capsys, *words):
    monkeypatch.setattr("sys.argv", ["roadgrip-rsu", *map(str, words), "--config", str(config)])
    with pytest.raises(SystemExit) as left:
        door.main()
    assert left.value.code == 2
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1
    return complaint


@pytest.fixture
def backup(config: Path, database: Path, shelf: Path, tmp_path: Path) -> Path:
    """A backup of a unit with twenty passages that has taken up releases before, made by the command."""
    kept(database, range(20))
    FolderShelf(shelf).keep_state(RolloutState(newest_sequence_number=7))
    path = tmp_path / "backup.tar.gz"
    done(config, "backup", path)
    return path


def part_of(archive: tarfile.TarFile, name: str) -> bytes:
    content = archive.extractfile(name)
    assert content is not None
    return content.read()


def remade(backup, changes):
    """Write a backup anew with other members; None leaves one out."""
    with tarfile.open(backup, "r:gz") as archive:
        members = {name: part_of(archive, name) for name in archive.getnames()}
    members.update(changes)
    with tarfile.open(backup, "w:gz") as archive:
        for name, content in members.items():
            if content is not None:
                member = tarfile.TarInfo(name)
                member.size = len(content)
                archive.addfile(member, io.BytesIO(content))


def manifest_of(backup):
    with tarfile.open(backup, "r:gz") as archive:
        content = archive.extractfile("manifest.json")
        assert content is not None
        return json.load(content)


# Making one ----------------------------------------------------------------------------------------------------------


def test_a_backup_names_all_it_holds_and_holds_no_keys(config, backup):
    (config.parent / "unit.pem").write_text("a secret")
    manifest = manifest_of(backup)
    assert [file["name"] for file in manifest["files"]] == [
        "database.sqlite3",
        "settings/rsu.toml",
        "settings/sections/1.json",
        "shelf/state.json",
    ]
    assert (manifest["unit"], manifest["revision"]) == ("fv27-bend", REVISION)
    with tarfile.open(backup) as archive:
        assert archive.getnames() == ["manifest.json", *(file["name"] for file in manifest["files"])]
    assert backup.stat().st_mode & 0o777 == 0o600


def test_a_backup_replaces_nothing_and_leaves_nothing_half(config, backup, monkeypatch, capsys):
    before = backup.read_bytes()
    assert "is there already" in refused(config, monkeypatch, capsys, "backup", backup)
    assert backup.read_bytes() == before
    assert sorted(path.name for path in backup.parent.iterdir()) == ["backup.tar.gz", "unit"]


def test_the_database_is_never_taken_for_the_backup(config, database, monkeypatch, capsys):
    kept(database, range(1))
    assert "end in .tar.gz" in refused(config, monkeypatch, capsys, "backup", database)


def test_there_is_no_backup_of_nothing_nor_of_something_damaged(config, database, tmp_path, monkeypatch, capsys):
    path = tmp_path / "backup.tar.gz"
    assert "does not exist yet" in refused(config, monkeypatch, capsys, "backup", path)
    kept(database, range(200))
    content = bytearray(database.read_bytes())
    content[4096 * 5 : 4096 * 20] = b"\xa5" * (4096 * 15)
    database.write_bytes(content)
    assert "worth nothing" in refused(config, monkeypatch, capsys, "backup", path)
    assert [each.name for each in tmp_path.iterdir()] == ["unit"]


def test_a_copy_beside_a_busy_writer_ends_and_holds_what_was_acknowledged_before(database, monkeypatch, tmp_path):
    monkeypatch.setattr(copying, "COPIED_AT_ONCE_COUNT", 1)
    kept(database, range(100))
    copied_bytes = []

    async def story():
        store = open_store(database)

        def write_meanwhile(done_bytes, _of_bytes):
            copied_bytes.append(done_bytes)
            # Every step of the copy waits for one more commit by the writer's own connection.
            asyncio.run_coroutine_threadsafe(store.append([make_entry(1_000 + len(copied_bytes))]), loop).result(10)

        loop = asyncio.get_running_loop()
        await asyncio.to_thread(copy_database, database, tmp_path / "copy", on_copied=write_meanwhile)
        await store.close()

    asyncio.run(story())
    # A copy that begins anew steps back.
    assert copied_bytes == sorted(copied_bytes)
    assert passages_count(tmp_path / "copy") == 100
    assert passages_count(database) == 100 + len(copied_bytes) > 110
    assert not list(tmp_path.glob("copy-*"))


def test_a_shelf_that_changes_while_it_is_copied_is_copied_again(config, database, shelf, tmp_path, monkeypatch):
    kept(database, range(3))
    FolderShelf(shelf).keep_state(RolloutState(newest_sequence_number=1))
    copies = []

    def copy_and_step(source, target, **rest):
        copy_database(source, target, **rest)
        copies.append(target)
        if len(copies) == 1:
            FolderShelf(shelf).keep_state(RolloutState(newest_sequence_number=2))

    monkeypatch.setattr("rsu_app.adapters.store.copy_database", copy_and_step)
    path = tmp_path / "backup.tar.gz"
    done(config, "backup", path)
    assert len(copies) == 2
    with tarfile.open(path) as archive:
        state = archive.extractfile("shelf/state.json")
        assert state is not None
        assert json.load(state)["newest_sequence_number"] == 2


# Restoring one -------------------------------------------------------------------------------------------------------


def test_a_restored_unit_is_what_it_was_and_what_it_had_is_kept(config, database, shelf, backup):
    kept(database, range(20, 50))
    FolderShelf(shelf).keep_state(RolloutState(newest_sequence_number=8))
    told = done(config, "restore", backup, "--by", "ann")
    assert passages_count(database) == 20
    assert FolderShelf(shelf).state().newest_sequence_number == 7
    [old_shelf, old_database] = map(Path, told["set_aside"])
    assert passages_count(old_database) == 50
    assert FolderShelf(old_shelf).state().newest_sequence_number == 8
    assert not list(database.parent.glob(".restore-*"))


def test_the_ledger_says_that_it_was_restored_by_whom_and_from_when(config, database, backup):
    done(config, "restore", backup, "--by", "ann")
    newest = newest_entries(database, limit_count=10)[0]
    assert (newest.actor, newest.action) == ("ann", Action.RESTORED)
    assert float(newest.evidence["backup_made_unix_s"]) == round(manifest_of(backup)["made_unix_s"])
    result = CliRunner().invoke(program.app, ["ledger", "verify", "--config", str(config)])
    assert result.exit_code == 0, result.output


def test_a_new_machine_takes_a_backup_up(config, database, backup, tmp_path):
    elsewhere = tmp_path / "new" / "rsu.toml"
    elsewhere.parent.mkdir()
    elsewhere.write_text('[database]\npath = "var/rsu.sqlite3"\n', encoding="utf-8")
    assert done(elsewhere, "restore", backup)["set_aside"] == []
    assert passages_count(elsewhere.parent / "var" / "rsu.sqlite3") == 20
    kept(elsewhere.parent / "var" / "rsu.sqlite3", range(100, 101))
    assert passages_count(elsewhere.parent / "var" / "rsu.sqlite3") == 21


def test_a_backup_of_older_software_is_migrated(config, database, tmp_path):
    engine = writing_engine_of(database)
    with engine.begin() as connection:
        alembic = alembic_config()
        alembic.attributes["connection"] = connection
        command.upgrade(alembic, "0001")
    engine.dispose()
    path = tmp_path / "backup.tar.gz"
    assert done(config, "backup", path)["revision"] == "0001"
    told = done(config, "restore", path)
    assert (told["revision_before"], told["revision"]) == ("0001", REVISION)


def writing_engine_of(database):
    database.parent.mkdir()
    return writing_engine(database)


def test_a_backup_of_newer_software_is_refused_and_nothing_is_touched(config, database, backup, monkeypatch, capsys):
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    newer = backup.with_name("newer.tar.gz")
    done(config, "backup", newer)
    before = sorted(path.name for path in database.parent.iterdir() if not path.name.endswith(("-shm", "-wal")))
    assert "9999" in refused(config, monkeypatch, capsys, "restore", newer)
    after = sorted(path.name for path in database.parent.iterdir() if not path.name.endswith(("-shm", "-wal")))
    assert before == after


def cut(backup):
    backup.write_bytes(backup.read_bytes()[:-200])


def one_bit(backup):
    content = bytearray(backup.read_bytes())
    content[len(content) // 2] ^= 4
    backup.write_bytes(content)


def other_content(backup):
    remade(
        backup,
        {
            "shelf/state.json": b"x"
            * next(file["size_bytes"] for file in manifest_of(backup)["files"] if file["name"] == "shelf/state.json")
        },
    )


def missing(backup):
    remade(backup, {"shelf/state.json": None})


def more(backup):
    remade(backup, {"shelf/stowaway": b"!"})


def leads_elsewhere(backup):
    manifest = manifest_of(backup)
    manifest["files"][-1]["name"] = "shelf/../../../outside"
    remade(backup, {"manifest.json": json.dumps(manifest).encode()})


def other_kind(backup):
    remade(backup, {"manifest.json": json.dumps({**manifest_of(backup), "format": "roadgrip-backup-2"}).encode()})


def not_an_archive(backup):
    backup.write_bytes(gzip.compress(b"a photograph"))


def no_backup(backup):
    with tarfile.open(backup, "w:gz") as archive:
        archive.addfile(tarfile.TarInfo("holiday.jpeg"))


def damaged_database(backup):
    """Spoil the database and let the manifest agree, as if it had been damaged before it was backed up."""
    with tarfile.open(backup, "r:gz") as archive:
        content = archive.extractfile("database.sqlite3")
        assert content is not None
        spoilt = bytearray(content.read())
    spoilt[4096 * 3 : 4096 * 6] = b"\xa5" * (4096 * 3)
    manifest = manifest_of(backup)
    for file in manifest["files"]:
        if file["name"] == "database.sqlite3":
            file["sha256"] = hashlib.sha256(spoilt).hexdigest()
    remade(backup, {"manifest.json": json.dumps(manifest).encode(), "database.sqlite3": bytes(spoilt)})


@pytest.mark.parametrize(
    "spoil",
    [
        cut,
        one_bit,
        other_content,
        missing,
        more,
        leads_elsewhere,
        other_kind,
        not_an_archive,
        no_backup,
        damaged_database,
    ],
)
def test_a_backup_that_is_not_what_it_was_is_refused_and_nothing_is_touched(
    config, database, backup, spoil, *, monkeypatch, capsys
):
    kept(database, range(20, 25))
    spoil(backup)
    before = sorted(path.name for path in database.parent.iterdir())
    assert str(backup) in refused(config, monkeypatch, capsys, "restore", backup)
    assert sorted(path.name for path in database.parent.iterdir()) == before
    assert passages_count(database) == 25


def test_a_running_unit_is_not_restored_under_its_feet(config, database, backup, monkeypatch, capsys):
    kept(database, range(20, 25))
    with asyncio.Runner() as runner:
        store = runner.run(opened(database))
        assert in_use(database)
        assert "stop it first" in refused(config, monkeypatch, capsys, "restore", backup)
        runner.run(store.close())
    assert not in_use(database)
    assert passages_count(database) == 26


async def opened(database):
    """Open a store and let it write, as every unit does in its first second: only then it holds the file."""
    store = open_store(database)
    await store.append([make_entry(60)])
    return store


def test_a_unit_that_only_answers_orders_is_running_too(config, database, shelf, backup, *, monkeypatch, capsys):
    database.unlink()
    # Something listens there, and is as silent as a unit that hangs.
    monkeypatch.setattr("rsu_app.backup_wiring.ANSWER_S", 0.1)
    with closing(control_socket(shelf / "control.sock")) as silent:
        silent.listen()
        assert "stop it first" in refused(config, monkeypatch, capsys, "restore", backup)
    assert not database.exists()


def test_an_operator_who_insists_may_restore_beside_a_running_unit(config, database, backup):
    kept(database, range(20, 25))
    with asyncio.Runner() as runner:
        store = runner.run(opened(database))
        told = done(config, "restore", backup, "--although-running")
        runner.run(store.append([make_entry(77)]))
        runner.run(store.close())
    assert passages_count(database) == 20
    # It went on with what it had.
    assert passages_count(Path(told["set_aside"][-1])) == 27


def test_a_damaged_database_gives_way_to_a_backup(config, database, backup):
    database.write_bytes(b"this was a database once\n" * 1_000)
    for companion in database.parent.glob("rsu.sqlite3-*"):
        companion.unlink()
    done(config, "restore", backup)
    assert passages_count(database) == 20


def test_if_the_new_cannot_be_put_in_place_the_old_stays(config, database, shelf, backup, *, monkeypatch, capsys):
    kept(database, range(20, 25))
    moves = []

    def move(source, target):
        moves.append(target)
        if len(moves) == 2:
            raise OSError(5, "Input/output error")
        return Path(source).rename(target)

    monkeypatch.setattr("rsu_app.backup_wiring.shutil.move", move)
    assert "Input/output error" in refused(config, monkeypatch, capsys, "restore", backup)
    assert passages_count(database) == 25
    assert FolderShelf(shelf).state().newest_sequence_number == 7
    assert not list(database.parent.glob("*before-restore*"))


def test_what_was_done_is_said_to_a_person(config, backup):
    result = CliRunner().invoke(program.app, ["restore", str(backup), "--config", str(config)])
    assert "restored: what was backed up of fv27-bend at 2" in result.stdout
    assert "delete it when all is well" in result.stdout
