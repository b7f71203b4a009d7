"""A road side unit in a process of its own, to be asked, stopped and killed."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Self

import httpx

from tests.bundles import make_bundle

START_S = 60.0


class Daemon:
    """`python -m rsu_app serve` on ports that the machine chooses; use it with `with`.

    Args:
        folder: Holds configuration, bundle and database; a second daemon in the same folder takes over from the first.
        settings: More TOML.
    """

    def __init__(self, folder: Path, settings: str = "") -> None:
        if not (folder / "bundle").exists():
            make_bundle(folder / "bundle")
        self.folder = folder
        self.config = folder / "rsu.toml"
        self.config.write_text(
            '[database]\npath = "rsu.sqlite3"\n[model]\nbundle_path = "bundle"\n[http]\nport = 0\n'
            f"shutdown_s = 2\n[udp]\nport = 0\n{settings}",
            encoding="utf-8",
        )
        self.log = folder / "log"

    def __enter__(self) -> Self:
        self._sink = self.log.open("wb")
        self.process = subprocess.Popen(
            [sys.executable, "-W", "error", "-m", "rsu_app", "serve", "--config", str(self.config)],
            stdout=self._sink,
            stderr=subprocess.STDOUT,
        )
        serving = self._wait_for("serving")
        self.url = serving["http"]
        self.udp_port = int(re.sub(r".*:", "", serving["udp"]))
        self.restored_count = serving["restored_count"]
        self.client = httpx.Client(base_url=self.url, timeout=30.0)
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._sink.close()

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

    def _wait_for(self, event: str) -> dict[str, Any]:
        give_up_s = time.monotonic() + START_S
        while time.monotonic() < give_up_s:
            assert self.process.poll() is None, self.log.read_text(encoding="utf-8")
            for line in self.lines():
                if line["event"] == event:
                    return line
            time.sleep(0.05)
        raise AssertionError(f"no {event!r} in {START_S} s\n{self.log.read_text(encoding='utf-8')}")
