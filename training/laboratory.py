"""The folder of a laboratory: data sets, records of experiments, the ledger, and the repository that units read.

lab/
  data/         data sets by their digests (`training.data.data_shelf`)
  mlflow.db     records of experiments and the register of models, with files in mlflow-files/
  bundles/      bundles that were fetched from the register, by their ids
  verdicts/     what the gate said, by the digest of the verdict
  repository/   the signed repository (`training.promotion`)
  ledger.jsonl  what was done to models, an entry a line
  rings.json    names of the rings in order, where they are not canary and all
"""

from __future__ import annotations

import fcntl
import getpass
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from roadgrip.ledger import Action, LedgerEntry, LedgerError, entry_after, entry_from_json, entry_to_json

LAB_VARIABLE = "ROADGRIP_LAB"
"""Names the folder of the laboratory where `--lab` does not."""
DEFAULT_FOLDER = Path("lab")


@dataclass(frozen=True, slots=True)
class Laboratory:
    """Where everything of a laboratory lies.

    Attributes:
        folder: Made when something is first put there.
    """

    folder: Path

    @property
    def data_folder(self) -> Path:
        """Data sets."""
        return self.folder / "data"

    @property
    def bundles_folder(self) -> Path:
        """Bundles that were fetched from the register."""
        return self.folder / "bundles"

    @property
    def verdicts_folder(self) -> Path:
        """What the gate said."""
        return self.folder / "verdicts"

    @property
    def repository_folder(self) -> Path:
        """The signed repository."""
        return self.folder / "repository"

    @property
    def ledger_path(self) -> Path:
        """What was done to models."""
        return self.folder / "ledger.jsonl"

    def ledger(self) -> list[LedgerEntry]:
        """Return the ledger, oldest entry first.

        Raises:
            LedgerError: A line is no entry.
        """
        if not self.ledger_path.exists():
            return []
        lines = self.ledger_path.read_text(encoding="utf-8").splitlines()
        entries = []
        for number, line in enumerate(lines, start=1):
            try:
                entries.append(entry_from_json(line))
            except LedgerError as error:
                raise LedgerError(f"{self.ledger_path}, line {number}: {error}") from error
        return entries

    def record(
        self,
        action: Action,
        subject: str,
        *,
        reason: str,
        evidence: Mapping[str, str] | None = None,
        actor: str | None = None,
        now_unix_s: float | None = None,
    ) -> LedgerEntry:
        """Return the entry that was appended to the ledger; it is on the disk.

        Args:
            action: What was done.
            subject: To what.
            reason: Why.
            evidence: What it rests on.
            actor: Who; the account this runs under by default.
            now_unix_s: When; now by default.

        Raises:
            LedgerError: The ledger cannot be read; nothing is appended to a broken one.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        with self._locked():
            held = self.ledger()
            entry = entry_after(
                held[-1] if held else None,
                at_unix_s=time.time() if now_unix_s is None else now_unix_s,
                actor=actor or account(),
                action=action,
                subject=subject,
                reason=reason,
                evidence=evidence,
            )
            with self.ledger_path.open("a", encoding="utf-8") as file:
                file.write(entry_to_json(entry) + "\n")
                file.flush()
                os.fsync(file.fileno())
        return entry

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Keep a second command from appending at the same time."""
        with (self.folder / ".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield


def account() -> str:
    """Return who runs this, for the ledger."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # no such account, as in some containers
        return f"uid {os.getuid()}"
