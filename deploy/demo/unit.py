"""The road side unit of the demo: a real process, watched through its HTTP interface and its database."""

from __future__ import annotations

import contextlib
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from dataclasses import dataclass, fields
from pathlib import Path
from typing import IO, Any

import httpx

from deploy.demo.story import Estimate
from roadgrip.errors import RoadgripError
from roadgrip.records import Advisory, AdvisoryReason, Confidence, FrictionInterval

READY_WALL_S = 60.0
STOP_WALL_S = 15.0
PREFERRED_HTTP_PORT = 8080
PREFERRED_UDP_PORT = 4740
ASK_WALL_S = 5.0


class DemoError(RoadgripError):
    """The demo cannot go on; the message says where to look."""


@dataclass(frozen=True, slots=True)
class UnitFiles:
    """Where the unit keeps its things.

    Attributes:
        config: Its settings.
        database: Its passages.
        log: What it wrote to standard output and error.
    """

    config: Path
    database: Path
    log: Path


def write_config(
    folder: Path, *, section: str, speedup_ratio: float, bundle: Path | None, usual_ports: bool = True
) -> tuple[UnitFiles, int, int]:
    """Write the settings of a unit into a folder; return its files, its HTTP port and its UDP port.

    Args:
        folder: Where the unit keeps everything.
        section: As in the unit's settings; a path must be absolute or relative to the folder.
        speedup_ratio: How fast the unit's clock runs.
        bundle: The model; None takes the packaged one.
        usual_ports: Whether to take the unit's usual ports when they are free; else the machine chooses.
    """
    http_port = free_port(socket.SOCK_STREAM, PREFERRED_HTTP_PORT if usual_ports else 0)
    udp_port = free_port(socket.SOCK_DGRAM, PREFERRED_UDP_PORT if usual_ports else 0)
    files = UnitFiles(folder / "rsu.toml", folder / "rsu.sqlite3", folder / "rsu.log")
    model = "" if bundle is None else f'\n[model]\nbundle_path = "{bundle.resolve()}"\n'
    files.config.write_text(
        f"""# Written by the demo; `roadgrip-rsu serve -c {files.config.name}` runs the same unit again.

[[sections]]
file = "{section}"

[database]
path = "{files.database.name}"

[http]
port = {http_port}

[udp]
port = {udp_port}

[clock]
speedup_ratio = {speedup_ratio} # an hour of traffic in {3600.0 / speedup_ratio:.0f} s; never do this beside a road
{model}""",
        encoding="utf-8",
    )
    return files, http_port, udp_port


def check_settings(files: UnitFiles) -> None:
    """Do nothing if the unit finds everything that its settings name: the section, the model.

    Raises:
        DemoError: It does not; the message says what.
    """
    _ask(["config", "check", "--config", str(files.config)], "the unit does not accept its settings")


def migrate(files: UnitFiles) -> None:
    """Make the unit's database.

    Raises:
        DemoError: It failed.
    """
    _ask(["db", "upgrade", "--config", str(files.config)], "the unit could not make its database")


class UnitProcess:
    """A running unit."""

    def __init__(self, files: UnitFiles, *, section_id: str, http_port: int) -> None:
        """Start it; `wait_until_ready` says when it answers."""
        self.url = f"http://127.0.0.1:{http_port}"
        self._files = files
        self._advisory_url = f"{self.url}/v1/sections/{section_id}/advisory"
        self._last_number = 0
        self._log: IO[bytes] = files.log.open("wb")
        self._process = subprocess.Popen(
            [*_rsu(), "serve", "--config", str(files.config)],
            stdout=self._log,
            stderr=subprocess.STDOUT,
            # Ctrl-C reaches the demo alone; the demo stops the unit as an operator would.
            process_group=0,
        )

    def wait_until_ready(self) -> None:
        """Return when the unit says it does its whole job.

        Raises:
            DemoError: It ended, or says for too long that it does not; the message holds its reasons.
        """
        deadline_s = time.monotonic() + READY_WALL_S
        answer = "it does not answer"
        while time.monotonic() < deadline_s:
            self.check_alive()
            with contextlib.suppress(httpx.HTTPError):
                response = httpx.get(f"{self.url}/health/ready", timeout=ASK_WALL_S)
                if response.is_success:
                    return
                answer = _conditions(response)
            time.sleep(0.1)
        raise DemoError(f"the unit is not ready after {READY_WALL_S:.0f} s: {answer}; its log is {self._files.log}")

    def check_alive(self) -> None:
        """Do nothing while the unit runs.

        Raises:
            DemoError: It ended.
        """
        code = self._process.poll()
        if code is not None:
            last = self._files.log.read_text(encoding="utf-8", errors="replace").splitlines()[-3:]
            raise DemoError(f"the unit ended with code {code}; its log {self._files.log} ends with: {' | '.join(last)}")

    async def advisory(self, client: httpx.AsyncClient) -> Advisory | None:
        """Return what the unit publishes now; None when it did not answer in time."""
        try:
            response = await client.get(self._advisory_url, timeout=ASK_WALL_S)
            response.raise_for_status()
        except httpx.HTTPError:
            return None
        return _advisory(response.json())

    def new_estimates(self) -> list[Estimate]:
        """Return what the unit stored since the last call, read beside it from its database.

        The estimate of a single passage is the unit's secret: no receipt and no interface tells it.
        """
        with contextlib.closing(sqlite3.connect(f"file:{self._files.database}?mode=ro", uri=True)) as database:
            rows = database.execute(
                "SELECT sequence_number, passage_id, mu, flags FROM passages WHERE sequence_number > ? "
                "ORDER BY sequence_number",
                (self._last_number,),
            ).fetchall()
        estimates = [
            Estimate(number, bytes(passage_id), mu, counted=flags == 0) for number, passage_id, mu, flags in rows
        ]
        if estimates:
            self._last_number = estimates[-1].sequence_number
        return estimates

    def stop(self) -> int:
        """Ask the unit to stop, as an operator would; return its exit code."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
        try:
            code = self._process.wait(STOP_WALL_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        self._log.close()
        return code


def _rsu() -> list[str]:
    return [sys.executable, "-m", "rsu_app"]


def _ask(arguments: list[str], failure: str) -> None:
    done = subprocess.run([*_rsu(), *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        said = (done.stderr.strip() or done.stdout.strip() or f"exit code {done.returncode}").splitlines()[-1]
        raise DemoError(f"{failure}: {said}")


def free_port(kind: socket.SocketKind, preferred: int = 0) -> int:
    """Return the preferred port if it is free on this machine, else one that is.

    Raises:
        DemoError: There is none.
    """
    for port in (preferred, 0):
        with socket.socket(socket.AF_INET, kind) as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return int(probe.getsockname()[1])
    raise DemoError("this machine has no free port")


def _conditions(response: httpx.Response) -> str:
    try:
        conditions = response.json()["conditions"]
        return "; ".join(f"{c['name']}: {c['detail']}" for c in conditions if c["required"] and not c["ok"])
    except (ValueError, KeyError, TypeError):
        return f"it answers {response.status_code}"


def _advisory(raw: dict[str, Any]) -> Advisory:
    interval = raw["interval"]
    # The page says more of an interval than the frames do.
    known = None if interval is None else {field.name: interval[field.name] for field in fields(FrictionInterval)}
    return Advisory(
        speed_mps=raw["speed_mps"],
        reason=AdvisoryReason(raw["reason"]),
        confidence=Confidence(raw["confidence"]),
        interval=None
        if known is None
        else FrictionInterval(**{**known, "confidence": Confidence(known["confidence"])}),
        valid_for_s=raw["valid_for_s"],
    )
