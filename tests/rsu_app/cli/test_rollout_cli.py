from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rsu_app.cli.main import app
from rsu_app.control_client import ControlError, ask
from rsu_app.settings import load_settings
from tests.bundles import make_bundle
from tests.repositories import SignedRepository


@pytest.fixture
def folder(tmp_path):
    make_bundle(tmp_path / "bundle")
    (tmp_path / "rsu.toml").write_text(
        '[database]\npath = "rsu.sqlite3"\n[model]\nbundle_path = "bundle"\n'
        '[updates]\ntrusted_root = "trusted-root.json"\nring = "canary"\nshadow_count = 3\n'
    )
    return tmp_path


@pytest.fixture
def repository(folder) -> SignedRepository:
    repository = SignedRepository(folder / "repository")
    (folder / "trusted-root.json").write_bytes(repository.trusted_root)
    make_bundle(folder / "newer", weights={"sideslip_mean_rad": 1.0, "steer_mean_rad": 1e-6})
    repository.release(folder / "newer", sequence_number=1)
    return repository


def said(folder: Path, *words: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, [*words, "--config", str(folder / "rsu.toml")])
    return result.exit_code, result.stdout


def test_without_a_running_unit_the_status_says_so(folder):
    assert said(folder, "status")[0] == 1
    assert "no unit runs" in said(folder, "status")[1]


def test_a_unit_that_does_not_run_takes_a_release_switches_and_steps_back(folder, repository):
    code, told = said(folder, "update", "--from", str(repository.folder), "--by", "ann")
    assert (code, "shadow" in told) == (0, True)
    assert said(folder, "update", "--from", str(repository.folder))[1].strip() == "there is no newer release"
    assert said(folder, "switch", "--reason", "now", "--by", "ann")[0] == 0
    assert said(folder, "rollback", "--reason", "no", "--by", "ann")[0] == 0
    code, told = said(folder, "rollback", "--reason", "once more", "--json")
    assert (code, json.loads(told)["reason"]) == (1, "no_release")
    code, told = said(folder, "ledger", "show", "--json")
    acts = [entry["action"] for entry in json.loads(told)["entries"]][::-1]
    assert acts[-4:] == ["installed", "shadowing", "switched", "rolled_back"]


def test_the_ledger_answers_which_bundle_was_live_and_who_let_it_out(folder, repository):
    said(folder, "update", "--from", str(repository.folder), "--by", "ann")
    said(folder, "switch", "--reason", "now", "--by", "ann")
    code, told = said(folder, "ledger", "at", "2999-01-01", "--json")
    found = json.loads(told)
    assert code == 0
    assert found["live"]["action"] == "switched"
    assert found["installed"]["evidence"]["gate"] == "passed"
    assert found["installed"]["evidence"]["laboratory_ledger_hash"]
    assert "installed" in said(folder, "ledger", "at", "2999-01-01")[1]
    assert said(folder, "ledger", "at", "1999-01-01")[0] == 1


def test_a_release_is_refused_while_nobody_is_trusted(folder, repository):
    config = folder / "rsu.toml"
    config.write_text(config.read_text().replace('trusted_root = "trusted-root.json"\n', ""))
    result = CliRunner().invoke(app, ["update", "--from", str(repository.folder), "--config", str(config)])
    assert result.exit_code != 0
    assert "trusted_root" in str(result.exception)


def test_a_foreign_repository_is_refused_with_its_reason(folder, repository):
    foreign = SignedRepository(folder / "foreign")
    foreign.release(folder / "newer", sequence_number=1)
    code, told = said(folder, "update", "--from", str(foreign.folder))
    assert (code, told.split(":")[0]) == (1, "bad_signature")


def test_the_shelf_lies_beside_the_database_unless_it_is_put_elsewhere(folder):
    from rsu_app.rollout_wiring import shelf_folder, socket_path

    settings = load_settings(folder / "rsu.toml")
    assert shelf_folder(settings) == folder / "roadgrip-models"
    assert socket_path(settings) == folder / "roadgrip-models" / "control.sock"


@contextmanager
def server_that_says(path: Path, words: bytes) -> Iterator[None]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
        link.bind(str(path))
        link.listen()

        def answer() -> None:
            connection, _ = link.accept()
            with connection:
                connection.recv(65_536)
                connection.sendall(words)

        thread = threading.Thread(target=answer)
        thread.start()
        yield
        thread.join()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (b"nonsense", "does not answer"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 4\r\n\r\nfour", "nonsense"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 40\r\n\r\n{}", "does not answer"),
    ],
)
def test_a_socket_where_something_else_answers_is_said_so(tmp_path, words, told):
    path = tmp_path / "s"
    with server_that_says(path, words), pytest.raises(ControlError, match=told):
        ask(path, "/status")


def test_where_nothing_answers_no_unit_runs(tmp_path):
    assert ask(tmp_path / "s", "/status") is None
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
        link.bind(str(tmp_path / "s"))
    assert ask(tmp_path / "s", "/status") is None
