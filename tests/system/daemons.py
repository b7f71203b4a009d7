"""A road side unit in a process of its own, to be asked, stopped and killed."""

from __future__ import annotations

import json
import re
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Protocol, Self

import httpx
from prometheus_client.parser import text_string_to_metric_families

from tests.bundles import make_bundle

START_S = 60.0


@dataclass(frozen=True)
class Stored:
    """Columns of the table of passages."""

    passage_id: bytes
    section_id: str
    map_version: str
    age_s: float
    received_unix_s: float
    left_unix_s: float
    flags: int


class Process(Protocol):
    """A process that was started here, as `subprocess` shows it."""

    pid: int

    def poll(self) -> int | None: ...

    def wait(self, timeout: float | None = None) -> int: ...

    def kill(self) -> None: ...

    def send_signal(self, sig: int, /) -> None: ...


class Daemon:
    """`python -m rsu_app serve` on ports that the machine chooses; use it with `with`.

    Args:
        folder: Holds configuration, bundle and database; a second daemon in the same folder takes over from the first.
        settings: More TOML; what stands before its first table belongs to `[udp]`.
        ports: HTTP and UDP, to come back where vehicles knew an earlier daemon (its `ports`).
    """

    def __init__(self, folder: Path, settings: str = "", *, ports: tuple[int, int] = (0, 0)) -> None:
        if not (folder / "bundle").exists():
            make_bundle(folder / "bundle")
        self.folder = folder
        self.config = folder / "rsu.toml"
        self.config.write_text(
            '[database]\npath = "rsu.sqlite3"\n[model]\nbundle_path = "bundle"\n'
            f"[http]\nport = {ports[0]}\nshutdown_s = 2\n[udp]\nport = {ports[1]}\n{settings}",
            encoding="utf-8",
        )
        self.log = folder / "log"

    def __enter__(self) -> Self:
        self._sink = self.log.open("wb")
        self.process = self.begin(self._sink)
        serving = self._wait_for("serving")
        self.url = serving["http"]
        self.udp_port = int(re.sub(r".*:", "", serving["udp"]))
        self.ports = (int(re.sub(r".*:", "", serving["http"])), self.udp_port)
        self.restored_count = serving["restored_count"]
        self.client = httpx.Client(base_url=self.url, timeout=30.0)
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._sink.close()

    def begin(self, sink: BinaryIO) -> Process:
        """Return the process, just started, that writes its log into a file."""
        command = [sys.executable, "-W", "error", "-m", "rsu_app", "serve", "--config", str(self.config)]
        return subprocess.Popen(command, stdout=sink, stderr=subprocess.STDOUT)

    def kill(self) -> None:
        """End it as a power cut does."""
        self.process.kill()
        self.process.wait()

    def stop(self) -> int:
        """Ask it to end and return its exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(timeout=30)

    def lines(self) -> list[dict[str, Any]]:
        text = self.log.read_text(encoding="utf-8")
        return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]

    def stored(self) -> list[Stored]:
        """Return what is in its database, in the order of arrival."""
        question = (
            "SELECT passage_id, section_id, map_version, age_s, received_unix_s, left_unix_s, flags FROM passages "
            "ORDER BY sequence_number"
        )
        with closing(sqlite3.connect(self.folder / "rsu.sqlite3")) as database:
            return [Stored(*row) for row in database.execute(question)]

    def rows(self, question: str, *values: object) -> list[tuple[Any, ...]]:
        """Return what its database answers."""
        with closing(sqlite3.connect(self.folder / "rsu.sqlite3")) as database:
            return list(database.execute(question, values))

    def window_count(self, section_id: str = "long-turn") -> int:
        """Return how many passages its interval counts."""
        interval = self.client.get(f"/v1/sections/{section_id}/friction").json()["interval"]
        return 0 if interval is None else int(interval["passages_count"])

    def metric(self, name: str, **labels: str) -> float:
        """Return the value of a series of its metrics, summed over the labels that are not given."""
        families = text_string_to_metric_families(self.client.get("/metrics").text)
        return sum(
            sample.value
            for family in families
            for sample in family.samples
            if sample.name == name and labels.items() <= sample.labels.items()
        )

    def _wait_for(self, event: str) -> dict[str, Any]:
        give_up_s = time.monotonic() + START_S
        while time.monotonic() < give_up_s:
            assert self.process.poll() is None, self.log.read_text(encoding="utf-8")
            for line in self.lines():
                if line["event"] == event:
                    return line
            time.sleep(0.05)
        raise AssertionError(f"no {event!r} in {START_S} s\n{self.log.read_text(encoding='utf-8')}")
