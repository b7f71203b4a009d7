from __future__ import annotations

import asyncio
import base64
import gzip
import json
import re
import signal
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import rsu_app.__main__ as door
import rsu_app.cli.main as program
from roadgrip.ledger import Action
from roadgrip.passage_export import TIME_STEP_S, head_from_json, passage_from_json
from roadgrip.section_file import section_from_json
from roadgrip.sections import read_section
from rsu_app.adapters.store import open_store
from tests.rsu_app.adapters.store.stories import make_entry
from tests.rsu_app.fakes import NOON_UNIX_S, make_passage, make_section

LONG_TURN = read_section("long-turn")
LIVE_ID = "dd1ff2271c966bec"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "rsu.toml"
    path.write_text(
        '[database]\npath = "rsu.sqlite3"\n[export]\nenabled = true\nunit_name = "fv27-bend"\n', encoding="utf-8"
    )
    return path


def entries(count, *, section=LONG_TURN):
    return [
        make_entry(
            received_unix_s=NOON_UNIX_S + 3.7 * seed,
            passage=make_passage(section, seed=seed, age_s=0.3),
            mu=seed / 1000,
        )
        for seed in range(1, count + 1)
    ]


def kept(config, passages):
    """Keep passages in the unit's database and return the head of its ledger."""

    async def story():
        store = open_store(config.parent / "rsu.sqlite3")
        await asyncio.gather(*(store.append([entry]) for entry in passages))
        entry = await store.record(
            at_unix_s=NOON_UNIX_S, actor="anna", action=Action.SWITCHED, subject=LIVE_ID, reason=""
        )
        await store.close()
        return entry.entry_hash

    return asyncio.run(story())


def exported(config, *arguments, out="export.ndjson.gz"):
    """Export and return what the command said, and the lines of the file."""
    path = config.parent / out
    result = CliRunner().invoke(
        program.app, ["export", "--config", str(config), "--out", str(path), "--json", *arguments]
    )
    assert result.exit_code == 0, result.output
    with gzip.open(path, "rt", encoding="utf-8") as file:
        return json.loads(result.stdout), file.read().splitlines()


def refused(monkeypatch, capsys, *arguments):
    monkeypatch.setattr("sys.argv", ["roadgrip-rsu", "export", *map(str, arguments)])
    with pytest.raises(SystemExit) as left:
        door.main()
    assert left.value.code == 2
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1
    return complaint


def test_every_passage_is_told_with_its_values(config):
    passages = entries(12)
    head_hash = kept(config, passages)
    told, (first, *lines) = exported(config)
    head = head_from_json(first)
    assert (head.unit, head.bundle_id, head.ledger_hash) == ("fv27-bend", LIVE_ID, head_hash)
    assert (told["passages_count"], told["bundle_id"], told["ledger_hash"]) == (12, LIVE_ID, head_hash)
    assert told["bytes"] == (config.parent / "export.ndjson.gz").stat().st_size
    found = {round(passage.mu * 1000): passage for passage in map(passage_from_json, lines) if passage.mu is not None}
    assert len(lines) == len(found) == 12
    for number, entry in enumerate(passages, start=1):
        assert np.array_equal(found[number].values, np.asarray(entry.passage.summary.values, np.float32))
        assert abs(found[number].left_unix_s - entry.estimate.left_unix_s) <= TIME_STEP_S / 2


def test_the_maps_that_are_served_come_along_and_older_passages_do_too(config):
    older = make_section("long-turn", radius_m=90.0)
    kept(config, entries(2, section=older))
    _, (first, *lines) = exported(config)
    maps = head_from_json(first).sections_json
    assert {version: section_from_json(text).version for version, text in maps.items()} == {
        LONG_TURN.version: LONG_TURN.version
    }
    assert {passage_from_json(line).map_version for line in lines} == {older.version} != {LONG_TURN.version}


def test_nothing_in_an_export_names_a_passage(config):
    passages = entries(30)
    kept(config, passages)
    _, lines = exported(config)
    text = "\n".join(lines).encode()
    secrets = [
        secret
        for entry in passages
        for secret in (entry.estimate.passage_id, entry.estimate.content_digest, entry.estimate.values_digest)
    ]
    unpacked = b"".join(base64.b64decode(json.loads(line)["values_base64_f4"]) for line in lines[1:])
    for secret in secrets:
        assert len(secret) >= 16
        assert secret not in text + unpacked
        assert secret.hex().encode() not in text.lower()
        # Of a part of it in the middle, which base64 writes alike wherever the whole begins.
        assert not any(base64.b64encode(secret[start:])[:12] in text for start in range(3))
    fields = {name for line in lines[1:] for name in json.loads(line)}
    telling = {name for name in fields if re.search(r"passage|digest|received|age|sequence", name)}
    assert telling == {"table_digest"}


def test_no_moment_in_a_passage_is_finer_than_the_step(config):
    kept(config, entries(30))
    _, (_, *lines) = exported(config)
    moments = [value for line in lines for name, value in json.loads(line).items() if name.endswith("unix_s")]
    assert len(moments) == 30
    assert {moment % TIME_STEP_S for moment in moments} == {0.0}


def test_the_order_of_lines_is_not_the_order_of_arrival(config):
    together = [
        make_entry(received_unix_s=NOON_UNIX_S + 0.01 * seed, passage=make_passage(LONG_TURN, seed=seed), mu=seed / 1e3)
        for seed in range(1, 41)
    ]
    kept(config, together)
    orders = []
    for number in range(2):
        _, (_, *lines) = exported(config, out=f"{number}.ndjson.gz")
        orders.append([round(1000 * json.loads(line)["mu"]) for line in lines])
    assert sorted(orders[0]) == sorted(orders[1])
    # Each differs from the order of arrival but once in 40!, and so do they from one another.
    assert orders[0] != orders[1]
    assert sorted(orders[0]) not in orders


def test_bounds_are_moments_in_utc_and_taken_to_the_step(config):
    kept(config, entries(12))
    told, (first, *lines) = exported(config, "--since", "2026-01-01T13:00:14+01:00", "--until", "2026-01-01T12:00:34")
    assert (told["since_unix_s"], told["until_unix_s"]) == (NOON_UNIX_S + 10.0, NOON_UNIX_S + 30.0)
    assert head_from_json(first).since_unix_s == NOON_UNIX_S + 10.0
    # Received every 3.7 s.
    assert sorted(round(1000 * json.loads(line)["mu"]) for line in lines) == [3, 4, 5, 6, 7, 8]


def test_exports_that_follow_one_another_hold_every_passage_once(config):
    kept(config, entries(12))
    times = ["2026-01-01", "2026-01-01T12:00:17", "2026-01-01T12:00:40", "2026-01-02"]
    held = []
    for number in range(3):
        _, (_, *lines) = exported(
            config, "--since", times[number], "--until", times[number + 1], out=f"{number}.ndjson.gz"
        )
        held += [round(1000 * json.loads(line)["mu"]) for line in lines]
    assert sorted(held) == list(range(1, 13))


def test_what_was_received_after_now_is_exported_too(config):
    # As in a demonstration, whose clock runs ahead of the world's.
    kept(config, [make_entry(1, received_unix_s=1e11)])
    told, lines = exported(config)
    assert told["passages_count"] == len(lines) - 1 == 1


def test_one_section_can_be_exported_alone(config):
    kept(config, [*entries(3), make_entry(50)])
    told, (_, *lines) = exported(config, "--section", "bend")
    assert told["passages_count"] == 1
    assert {json.loads(line)["section_id"] for line in lines} == {"bend"}


def test_without_the_operators_word_nothing_is_exported(config, monkeypatch, capsys):
    kept(config, entries(1))
    monkeypatch.setenv("ROADGRIP_EXPORT__ENABLED", "false")
    out = config.parent / "export.ndjson.gz"
    assert "export.enabled is false" in refused(monkeypatch, capsys, "--config", config, "--out", out)
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--since", "yesterday"], "--since: 'yesterday' is no moment"),
        (["--until", "2026-13-01"], "--until: '2026-13-01' is no moment"),
        (["--since", "2026-01-02", "--until", "2026-01-01"], "nothing can have come in between"),
        (["--since", "2026-01-02T06:00:01", "--until", "2026-01-02T06:00:09"], "nothing can have come in between"),
        (["--section", "nowhere"], "no passages of 'nowhere'"),
    ],
)
def test_what_cannot_be_exported_is_said_in_one_line(config, monkeypatch, capsys, arguments, complaint):
    kept(config, entries(1))
    out = config.parent / "export.ndjson.gz"
    assert complaint in refused(monkeypatch, capsys, "--config", config, "--out", out, *arguments)
    assert not out.exists()


def test_a_file_that_is_there_is_replaced_only_when_asked_to(config, monkeypatch, capsys):
    kept(config, entries(1))
    out = config.parent / "export.ndjson.gz"
    out.write_bytes(b"the export of yesterday")
    assert "--force replaces it" in refused(monkeypatch, capsys, "--config", config, "--out", out)
    assert out.read_bytes() == b"the export of yesterday"
    _, lines = exported(config, "--force")
    assert len(lines) == 2


def test_the_database_is_never_taken_for_the_file(config, monkeypatch, capsys):
    kept(config, entries(1))
    database = config.parent / "rsu.sqlite3"
    complaint = refused(monkeypatch, capsys, "--config", config, "--out", database, "--force")
    assert "let its name end in" in complaint


def test_a_unit_without_a_database_has_nothing_to_export(config, monkeypatch, capsys):
    out = config.parent / "export.ndjson.gz"
    assert "does not exist yet" in refused(monkeypatch, capsys, "--config", config, "--out", out)
    assert [file.name for file in config.parent.iterdir()] == ["rsu.toml"]


def test_a_request_to_end_ends_an_export_as_ctrl_c_does_and_leaves_nothing(config, monkeypatch):
    kept(config, entries(3))

    def interrupted(*_):
        signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr("rsu_app.export_file.passage_to_json", interrupted)
    before = signal.getsignal(signal.SIGTERM)
    out = config.parent / "export.ndjson.gz"
    result = CliRunner().invoke(program.app, ["export", "--config", str(config), "--out", str(out)])
    assert result.exit_code != 0
    assert not [file for file in config.parent.iterdir() if "export" in file.name]
    assert signal.getsignal(signal.SIGTERM) is before


def test_what_was_written_is_said_to_a_person(config):
    kept(config, entries(2))
    out = config.parent / "export.ndjson.gz"
    result = CliRunner().invoke(
        program.app, ["export", "--config", str(config), "--out", str(out), "--until", "2026-01-02"]
    )
    assert f"written: {out}, 2 passages of fv27-bend, 1970-01-01T00:00:00Z to 2026-01-02T00:00:00Z" in result.stdout
