"""The daemon under load: the real one, with the packaged bundle and sections, on a disk."""

from __future__ import annotations

import json
import re
import sys
import time
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from prometheus_client.parser import text_string_to_metric_families

from bench.appliance.processes import cpu_s, resident_mb, running, wait_until
from bench.appliance.sections import write_sections

START_S = 60.0


@dataclass(frozen=True, slots=True)
class Unit:
    """A running daemon.

    Attributes:
        process_id: Of the daemon.
        host: Where it listens.
        http_port: For HTTP.
        udp_port: For frames.
        ready_s: From its start to the first answer that it is ready.
        folder: Holds its database and its log.
    """

    process_id: int
    host: str
    http_port: int
    udp_port: int
    ready_s: float
    folder: Path

    @property
    def cpu_s(self) -> float:
        """Processor time so far, all threads."""
        return cpu_s(self.process_id)

    @property
    def resident_mb(self) -> float:
        """Memory now."""
        return resident_mb(self.process_id)

    def get(self, path: str) -> bytes:
        """Return the body of an answer."""
        with urllib.request.urlopen(f"http://{self.host}:{self.http_port}{path}", timeout=30.0) as answer:
            body: bytes = answer.read()
        return body

    def metric(self, name: str, **labels: str) -> float:
        """Return the value of a series of its metrics, summed over the labels that are not given."""
        return self.metrics_sum(((name, labels),))[0]

    def metrics_sum(self, wanted: tuple[tuple[str, Mapping[str, str]], ...]) -> list[float]:
        """Return the values of some series as they are at one time, each as `metric` does."""
        samples = [
            sample
            for family in text_string_to_metric_families(self.get("/metrics").decode())
            for sample in family.samples
        ]
        return [
            sum(sample.value for sample in samples if sample.name == name and labels.items() <= sample.labels.items())
            for name, labels in wanted
        ]

    def kernel_drops_count(self) -> int:
        """Return how many datagrams the kernel threw away since its socket had no room; Linux tells it."""
        ending = f":{self.udp_port:04X}"
        for line in Path("/proc/net/udp").read_text(encoding="ascii").splitlines()[1:]:
            fields = line.split()
            if fields[1].endswith(ending):
                return int(fields[-1])
        return 0


@contextmanager
def serving(
    folder: Path, settings: str = "", *, tell_imports: bool = False, environment: Mapping[str, str] | None = None
) -> Iterator[Unit]:
    """Give a daemon that is ready; nothing is chosen but where things are and which sections it serves.

    Args:
        folder: Holds configuration, database and log; on a real disk.
        settings: More TOML; what stands before its first table belongs to `[udp]`.
        tell_imports: Whether its log tells every module that it imports.
        environment: Settings as the environment spells them, for those of the tables that are written here.
    """
    config, log = folder / "rsu.toml", folder / "log"
    here = '[database]\npath = "rsu.sqlite3"\n[http]\nport = 0\n[udp]\nport = 0\n'
    config.write_text(write_sections(folder) + here + settings, encoding="utf-8")
    log.write_bytes(b"")
    began_s = time.perf_counter()
    command: list[str | Path] = [sys.executable, "-m", "rsu_app", "serve", "--config", config]
    surroundings = {**(environment or {}), **({"PYTHONPROFILEIMPORTTIME": "1"} if tell_imports else {})}
    with running(command, log=log, environment=surroundings) as process:
        serving_line: dict[str, Any] = {}

        def serves() -> bool:
            serving_line.update(_line(log, "serving"))
            return bool(serving_line)

        wait_until(serves, process, log=log, limit_s=START_S)
        host, _, http_port = serving_line["http"].removeprefix("http://").rpartition(":")
        udp_port = int(re.sub(r".*:", "", serving_line["udp"]))
        unit = Unit(process.pid, host, int(http_port), udp_port, 0.0, folder)
        wait_until(lambda: _is_ready(unit), process, log=log, limit_s=START_S)
        ready_s = time.perf_counter() - began_s
        yield Unit(process.pid, host, int(http_port), udp_port, ready_s, folder)


def _is_ready(unit: Unit) -> bool:
    try:
        return bool(json.loads(unit.get("/health/ready"))["ready"])
    except OSError:  # it does not answer yet, or answers that it is not
        return False


def _line(log: Path, event: str) -> dict[str, Any]:
    for line in log.read_text(encoding="utf-8").splitlines(keepends=True):
        if line.endswith("\n") and f'"event": "{event}"' in line:
            told: dict[str, Any] = json.loads(line)
            return told
    return {}
