"""What a service manager hears of a unit, from its start over a writer that hangs to its end; what operators see."""

from __future__ import annotations

import json
import socket
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing

import pytest
from typer.testing import CliRunner, Result

import rsu_app.cli.main as program
from roadgrip.section_file import section_from_json
from tests.rsu_app.fakes import make_passage
from tests.rsu_app.sites import passage_json
from tests.system.daemons import Daemon

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]

PATIENCE_S = 30.0
WATCHDOG_S = 0.6
BUSY_TIMEOUT_S = 5.0
"""How long SQLite waits for a lock before it gives up; as long the writer is stuck in one write."""


class Manager:
    """The end of the socket that systemd listens on."""

    def __init__(self, link: socket.socket) -> None:
        self._link = link

    def hear_until(self, words: str) -> list[str]:
        """Return all that was said from now on, up to a message that holds some words."""
        said: list[str] = []
        while not said or words not in said[-1]:
            said.append(self._link.recv(4096).decode())
        return said


@pytest.fixture
def manager(tmp_path, monkeypatch) -> Iterator[Manager]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.bind(str(tmp_path / "notify"))
        link.settimeout(PATIENCE_S)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", str(round(WATCHDOG_S * 1e6)))
        yield Manager(link)


def asked(daemon: Daemon, *words: str) -> Result:
    """Return what a command says of a running unit; in this process, which has the libraries loaded."""
    return CliRunner().invoke(program.app, [*words, "--config", str(daemon.config)])


def test_a_manager_hears_of_the_start_of_a_writer_that_hangs_and_of_the_end(tmp_path, manager):
    with Daemon(tmp_path) as daemon:
        first = manager.hear_until("READY=1")[-1]
        assert "STATUS=serving; long-turn: 0 vehicles" in first
        assert "STATUS=serving" in manager.hear_until("WATCHDOG=1")[-1]

        section = section_from_json(daemon.client.get("/v1/sections/long-turn/map").text)
        body = passage_json(make_passage(section, mu=0.4))
        with closing(sqlite3.connect(tmp_path / "rsu.sqlite3", isolation_level=None)) as holder:
            holder.execute("BEGIN IMMEDIATE")
            sender = threading.Thread(
                target=daemon.client.post, args=("/v1/sections/long-turn/passages",), kwargs={"json": body}
            )
            sender.start()
            assert "WATCHDOG" not in manager.hear_until("the same write has been under way")[-1]
            # The unit goes on, and says what keeps it to those who ask, once it has lasted for some seconds.
            while (told := asked(daemon, "status", "--once")).exit_code == 0:
                pass
            assert "store: " in told.stdout
        sender.join(BUSY_TIMEOUT_S)
        manager.hear_until("WATCHDOG=1")

        assert daemon.stop() == 0
        assert "STATUS=stopping" in manager.hear_until("STOPPING=1")[-1]


def test_the_running_unit_shows_its_refusals_and_is_found_well(tmp_path):
    with Daemon(tmp_path) as daemon:
        section = section_from_json(daemon.client.get("/v1/sections/long-turn/map").text)
        for seed in range(3):
            body = passage_json(make_passage(section, seed=seed, mu=0.4))
            daemon.client.post("/v1/sections/long-turn/passages", json=body).raise_for_status()
        stale = passage_json(make_passage(section, seed=9, mu=0.4), map_version="0" * 16)
        daemon.client.post("/v1/sections/long-turn/passages", json=stale)
        told = json.loads(asked(daemon, "status", "--json").stdout)
        assert told["ready"] is True
        assert told["passages"]["outcomes"]["counted"] == 3
        assert [each["reason"] for each in told["traffic"]["refusals"]] == ["stale_map"]
        assert told["traffic"]["per_s"]["counted"] > 0.0
        assert told["disk"]["passages_count"] == 3
        assert told["process"]["process_number"] == daemon.process.pid
        shown = asked(daemon, "status")
        assert shown.exit_code == 0
        assert "stale_map, json, long-turn" in shown.stdout
        # The doctor looks at the same unit from outside, and finds it well.
        examined = asked(daemon, "doctor", "--json")
        findings = {finding["name"]: finding["level"] for finding in json.loads(examined.stdout)}
        well = ("unit", "commits", "sections", "bundle", "passages", "http port", "disk")
        assert {name: findings[name] for name in well} == dict.fromkeys(well, "ok")
