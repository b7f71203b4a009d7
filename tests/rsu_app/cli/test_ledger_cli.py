from __future__ import annotations

import asyncio
import json
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from typer.testing import CliRunner

import rsu_app.__main__ as door
import rsu_app.cli.main as program
from roadgrip.ledger import Action, chain_problems, entry_from_json
from rsu_app.adapters.store import open_store
from tests.rsu_app.fakes import NOON_UNIX_S


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """A unit whose ledger has four entries."""
    path = tmp_path / "rsu.toml"
    path.write_text('[database]\npath = "rsu.sqlite3"\n[export]\nunit_name = "fv27-bend"\n', encoding="utf-8")

    async def story():
        store = open_store(tmp_path / "rsu.sqlite3")
        for number, action in enumerate([Action.INSTALLED, Action.SWITCHED, Action.ROLLED_BACK]):
            await store.record(
                at_unix_s=NOON_UNIX_S + number,
                actor="anna",
                action=action,
                subject=f"dd1ff2271c966be{number}",
                reason="too [bold]slippery\x1b[2J",
                evidence={"gate": "passed"},
            )
        await store.close()

    asyncio.run(story())
    return path


def said(*arguments, code=0):
    result = CliRunner().invoke(program.app, ["ledger", *arguments], env={"COLUMNS": "200"})
    assert result.exit_code == code, result.output
    return result.stdout


def tampered(config, statement):
    with closing(sqlite3.connect(config.parent / "rsu.sqlite3")) as connection, connection:
        for name in ("ledger_only_grows", "ledger_never_changes", "ledger_keeps_the_newest"):
            connection.execute(f"DROP TRIGGER {name}")
        connection.execute(statement)


def test_the_newest_entries_are_shown_first(config):
    lines = [line for line in said("show", "--config", str(config)).splitlines() if "anna" in line]
    assert [word in line for word, line in zip(("rolled_back", "switched", "installed"), lines, strict=True)]
    assert ["2026-01-01T12:00:02Z" in line for line in lines] == [True, False, False]
    shown = said("show", "--limit", "1", "--config", str(config))
    assert "gate: passed" in shown
    assert "rolled_back" in shown
    assert "switched" not in shown


def test_what_others_wrote_does_nothing_to_a_terminal(config):
    shown = said("show", "--config", str(config))
    assert "\x1b[2J" not in shown
    assert "too [bold]slippery�[2J" in shown


def test_a_machine_gets_the_whole_chain(config):
    told = json.loads(said("show", "--json", "--config", str(config)))
    assert told["unit"] == "fv27-bend"
    entries = [entry_from_json(json.dumps(entry)) for entry in told["entries"]]
    assert len(entries) == 4
    assert chain_problems(entries[::-1]) == []


def test_a_ledger_that_holds_together_is_said_with_its_head(config):
    head = json.loads(said("show", "--json", "--limit", "1", "--config", str(config)))["entries"][0]["entry_hash"]
    assert said("verify", "--config", str(config)) == f"4 entries hold together; the head is {head}\n"
    told = json.loads(said("verify", "--json", "--head", head.upper(), "--config", str(config)))
    assert told == {"ok": True, "entries_count": 4, "head": head, "problems": []}


def test_every_problem_is_a_line_and_the_exit_code_is_1(config):
    tampered(config, "UPDATE ledger SET reason = 'another' WHERE sequence_number IN (2, 3)")
    lines = said("verify", "--config", str(config), code=1).splitlines()
    assert [line[: len("entry 2 was changed")] for line in lines] == ["entry 2 was changed", "entry 3 was changed"]
    assert json.loads(said("verify", "--json", "--config", str(config), code=1))["problems"] == lines


def test_newest_entries_that_were_cut_off_are_noticed_by_whoever_has_an_old_head(config):
    head = json.loads(said("verify", "--json", "--config", str(config)))["head"]
    tampered(config, "DELETE FROM ledger WHERE sequence_number = 4")
    said("verify", "--config", str(config))
    assert head[:16] in said("verify", "--head", "0" * 64, "--head", head, "--config", str(config), code=1)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [(["verify", "--head", "2f1c"], "'2f1c' is no hash"), (["show"], "entry 4 cannot be read")],
)
def test_what_cannot_be_answered_is_one_line_and_exit_code_2(config, monkeypatch, capsys, arguments, complaint):
    tampered(config, "UPDATE ledger SET action = 'no such act' WHERE sequence_number = 4")
    monkeypatch.setattr("sys.argv", ["roadgrip-rsu", "ledger", *arguments, "--config", str(config)])
    with pytest.raises(SystemExit) as left:
        door.main()
    assert left.value.code == 2
    told = capsys.readouterr().err
    assert complaint in told
    assert told.count("\n") == 1


def test_looking_changes_nothing(config):
    database = config.parent / "rsu.sqlite3"
    before = database.read_bytes()
    for arguments in (["show"], ["verify"]):
        said(*arguments, "--config", str(config))
    assert database.read_bytes() == before
