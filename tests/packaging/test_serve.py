"""An operator's first hour: install the wheel in an empty environment, migrate, serve, and ask whether it is well."""

import json
import signal
import socket
import sqlite3
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.packaging.conftest import Environment, bare_environ

pytestmark = [pytest.mark.xdist_group("packaging"), pytest.mark.system, pytest.mark.timeout(300)]

START_S = 60.0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module")
def environment(locked_environment: Callable[[str], Environment]) -> Environment:
    return locked_environment("rsu")


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """A working directory that is neither the checkout nor the one of the configuration."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    return folder


@pytest.fixture
def configuration(tmp_path: Path) -> Path:
    file = tmp_path / "rsu.toml"
    file.write_text(
        f"""
        [database]
        path = "passages.sqlite3"
        [http]
        port = {free_port()}
        [udp]
        port = 0
        """,
        encoding="utf-8",
    )
    return file


def http_port(configuration: Path) -> int:
    return int(configuration.read_text(encoding="utf-8").split("port =")[1].split()[0])


@contextmanager
def serving(environment: Environment, configuration: Path, *, cwd: Path) -> Iterator[subprocess.Popen[bytes]]:
    log = configuration.with_suffix(".log")
    with log.open("wb") as sink:
        process = subprocess.Popen(
            [environment.program("roadgrip-rsu"), "serve", "--config", str(configuration)],
            cwd=cwd,
            env=bare_environ(),
            stdout=sink,
            stderr=subprocess.STDOUT,
        )
        try:
            yield process
        finally:
            process.kill()
            process.wait()


def ready(configuration: Path, process: subprocess.Popen[bytes]) -> tuple[int, dict[str, Any]]:
    """Return status and body of the first answer about readiness."""
    url = f"http://127.0.0.1:{http_port(configuration)}/health/ready"
    give_up_s = time.monotonic() + START_S
    while time.monotonic() < give_up_s:
        assert process.poll() is None, configuration.with_suffix(".log").read_text(encoding="utf-8")
        try:
            with urllib.request.urlopen(url, timeout=5) as answer:
                return answer.status, json.load(answer)
        except urllib.error.HTTPError as refusal:
            with refusal:
                return refusal.code, json.load(refusal)
        except OSError:
            time.sleep(0.1)
    pytest.fail(f"no answer in {START_S} s\n{configuration.with_suffix('.log').read_text(encoding='utf-8')}")


def test_the_installed_wheel_migrates_a_new_database(environment, configuration, elsewhere):
    upgraded = environment.run("roadgrip-rsu", "db", "upgrade", "--config", str(configuration), cwd=elsewhere)
    assert upgraded.returncode == 0, upgraded.stdout + upgraded.stderr
    checked = environment.run("roadgrip-rsu", "db", "check", "--config", str(configuration), cwd=elsewhere)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    database = sqlite3.connect(configuration.parent / "passages.sqlite3")
    try:
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    finally:
        database.close()
    assert "alembic_version" in tables
    assert len(tables) > 1


def test_the_installed_wheel_serves_with_the_bundle_and_the_road_it_brings(environment, configuration, elsewhere):
    with serving(environment, configuration, cwd=elsewhere) as process:
        status, body = ready(configuration, process)
        assert status == 200, body
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=30) == 0
    assert list(elsewhere.iterdir()) == [], "serving leaves nothing in the working directory"
