"""A real client in a process of its own, on a road that takes no simulator."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from roadgrip.section import RoadSection
from roadgrip.section_file import section_to_json
from tests.vehicle_client.synthetic import drive_over, fixes_of, road, s_turn, surveyed, with_noise
from vehicle_client.estimation.trace import Trace
from vehicle_client.shell.sources import write_trace_csv

WAIT_S = 60.0
SPEEDUP = 20
ROAD = surveyed(road(s_turn))


def free_udp_port() -> int:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as link:
        link.bind(("127.0.0.1", 0))
        return int(link.getsockname()[1])


def a_drive(*, satellites: bool = True, approach_m: float = 400.0, exit_m: float = 250.0, seed: int = 1) -> Trace:
    """Return a drive over `ROAD` at 15 m/s."""
    rng = np.random.default_rng(seed)
    trace, station = drive_over(s_turn, approach_m=approach_m, exit_m=exit_m)
    gnss = fixes_of(ROAD, trace.time_s, station, rng=rng, noise_m=0.5) if satellites else None
    return replace(with_noise(trace, rng), gnss=gnss)


def standing(trace: Trace, duration_s: float = 600.0) -> Trace:
    """Return a car that stands somewhere, without satellites."""
    count = round(100.0 * duration_s)
    flat = np.zeros(count)
    return replace(
        trace,
        time_s=np.arange(count) / 100.0,
        accel_x_mps2=flat,
        accel_y_mps2=flat,
        roll_rate_radps=flat,
        yaw_rate_radps=flat,
        steer_rad=flat,
        wheel_speed_mps=np.zeros((count, 4)),
        valid=np.ones(count, dtype=np.bool_),
        gnss=None,
    )


def unit_settings(folder: Path, *, beacon_port: int, section: RoadSection = ROAD) -> str:
    """Return settings of a unit that serves the road and sends beacons to a port of this machine."""
    (folder / "road.json").write_text(section_to_json(section), encoding="utf-8")
    return (
        f'broadcast_host = "127.0.0.1"\nbroadcast_port = {beacon_port}\nbeacon_period_s = 0.3\n'
        '[[sections]]\nfile = "road.json"\n'
    )


class Car:
    """`roadgrip-vehicle live` that plays a drive; use it with `with`.

    Args:
        folder: Holds recording, spool, dashboard socket and log; a second car in the same folder takes over the spool.
        trace: What is played.
        options: More of the command line.
    """

    def __init__(self, folder: Path, trace: Trace, *options: str, speedup: float = SPEEDUP) -> None:
        self.folder = folder
        folder.mkdir(exist_ok=True)
        self.log = folder / f"log-{time.monotonic_ns()}"
        self.socket = folder / "dash.sock"
        self.spool = folder / "spool"
        recording = folder / "drive.csv"
        write_trace_csv(recording, trace)
        self.command = [sys.executable, "-W", "error", "-m", "vehicle_client", "live", "--play", str(recording)]
        self.command += ["--speedup", str(speedup), "--spool", str(self.spool), "--dashboard", str(self.socket)]
        self.command += options

    def __enter__(self) -> Self:
        self._sink = self.log.open("wb")
        self.process = subprocess.Popen(self.command, stdout=self._sink, stderr=subprocess.STDOUT)
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._sink.close()

    def kill(self) -> None:
        """End it as a power cut does."""
        self.process.kill()
        self.process.wait()

    def stop(self) -> int:
        """Ask it to end, and return its exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(timeout=WAIT_S)

    def lines(self) -> list[dict[str, Any]]:
        text = self.log.read_text(encoding="utf-8")
        return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]

    def events(self, name: str) -> list[dict[str, Any]]:
        return [line for line in self.lines() if line["event"] == name]

    def wait_for(self, what: Callable[[], object]) -> None:
        """Wait until something is so."""
        give_up_s = time.monotonic() + WAIT_S
        while not what():
            assert time.monotonic() < give_up_s, self.log.read_text(encoding="utf-8")
            assert self.process.poll() is None or what(), self.log.read_text(encoding="utf-8")
            time.sleep(0.02)

    def spooled(self) -> list[Path]:
        return sorted(self.spool.glob("*.json"))

    def dashboard(self) -> Reader:
        self.wait_for(self.socket.exists)
        return Reader(self.socket)


class Reader:
    """One dashboard."""

    def __init__(self, path: Path) -> None:
        self._link = socket.socket(socket.AF_UNIX)
        self._link.settimeout(WAIT_S)
        self._link.connect(str(path))
        self._file = self._link.makefile("r", encoding="utf-8")

    def until(self, what: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        """Return the first line that is so."""
        for line in self._file:
            told: dict[str, Any] = json.loads(line)
            if what(told):
                return told
        raise AssertionError("the client closed the socket")

    def ask(self, word: str) -> None:
        self._link.sendall(word.encode() + b"\n")

    def close(self) -> None:
        self._file.close()
        self._link.close()
