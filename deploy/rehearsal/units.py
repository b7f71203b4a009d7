"""Two road side units of different rings, and what can be read beside them."""

from __future__ import annotations

import contextlib
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from deploy.demo.unit import free_port
from deploy.rehearsal.commands import RehearsalError
from deploy.rehearsal.traffic import SECTION

START_S = 60.0
STOP_S = 15.0
LOOK_S = 0.1


class Unit:
    """A running unit of a ring.

    Args:
        folder: Holds its settings and everything it keeps; made.
        ring: Its ring.
        factory: Bundle it is delivered with.
        repository: Where releases come from.
        trusted_root: What the technician brought.
        passages_count: How long a new bundle is compared, before and after the switch.
        settings: More lines for `[updates]`; the period in which it looks for releases among them.
    """

    def __init__(
        self,
        folder: Path,
        *,
        ring: str,
        factory: Path,
        repository: Path,
        trusted_root: Path,
        passages_count: int,
        settings: str = "poll_period_s = 1.0\n",
    ) -> None:
        self.ring = ring
        self.folder = folder
        self.rng = np.random.default_rng(list(ring.encode()))
        folder.mkdir(parents=True)
        port = free_port(socket.SOCK_STREAM)
        self.url = f"http://127.0.0.1:{port}"
        self.config = folder / "rsu.toml"
        self.config.write_text(
            f"""[[sections]]
file = "{SECTION}"

[database]
path = "rsu.sqlite3"

[model]
bundle_path = "{factory.resolve()}"

[http]
port = {port}

[udp]
enabled = false

[updates]
source = "{repository.resolve()}"
trusted_root = "{trusted_root.resolve()}"
ring = "{ring}"
{settings}shadow_count = {passages_count}
probation_count = {passages_count}
judged_from_count = {max(5, passages_count // 3)}

[export]
enabled = true
unit_name = "{ring}-unit"
""",
            encoding="utf-8",
        )
        self._log = (folder / "rsu.log").open("wb")
        self._process = subprocess.Popen(
            [sys.executable, "-m", "rsu_app", "serve", "--config", str(self.config)],
            stdout=self._log,
            stderr=subprocess.STDOUT,
            process_group=0,
        )

    def wait_until_ready(self) -> None:
        """Return when it does its whole job.

        Raises:
            RehearsalError: It ended, or takes too long.
        """
        self.wait_for("being ready", self._ready, within_s=START_S)

    def wait_for(self, what: str, found: Callable[[], bool], *, within_s: float = 60.0) -> None:
        """Return when something is found.

        Raises:
            RehearsalError: It is not found in time, or the unit ended.
        """
        give_up_s = time.monotonic() + within_s
        while not found():
            if self._process.poll() is not None:
                raise RehearsalError(f"the {self.ring} unit ended; see {self.folder / 'rsu.log'}")
            if time.monotonic() > give_up_s:
                raise RehearsalError(f"the {self.ring} unit: {what} did not come within {within_s:.0f} s")
            time.sleep(LOOK_S)

    def rows(self, question: str, *values: object) -> list[tuple[Any, ...]]:
        """Return what its database answers, read beside it."""
        with contextlib.closing(sqlite3.connect(f"file:{self.folder / 'rsu.sqlite3'}?mode=ro", uri=True)) as database:
            return list(database.execute(question, values))

    def told(self, action: str, bundle_id: str) -> bool:
        """Return whether its ledger tells of an act on a bundle."""
        asked = "SELECT 1 FROM ledger WHERE action = ? AND (subject = ? OR evidence_json LIKE ?)"
        return bool(self.rows(asked, action, bundle_id, f"%{bundle_id}%"))

    @property
    def live_id(self) -> str:
        """The bundle that its ledger says is live."""
        asked = (
            "SELECT subject FROM ledger WHERE action IN ('live', 'switched', 'rolled_back') "
            "ORDER BY sequence_number DESC LIMIT 1"
        )
        return str(self.rows(asked)[0][0])

    def stop(self) -> None:
        """Ask it to stop, as an operator would."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(STOP_S)
            self._process.kill()
        self._process.wait()
        self._log.close()

    def _ready(self) -> bool:
        with contextlib.suppress(httpx.HTTPError):
            return httpx.get(f"{self.url}/health/ready", timeout=5.0).is_success
        return False
