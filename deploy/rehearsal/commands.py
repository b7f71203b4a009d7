"""Commands as an operator types them, shown before they run."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from deploy.rehearsal.warm import WarmPrograms
from roadgrip.errors import RoadgripError


class RehearsalError(RoadgripError):
    """The rehearsal cannot go on; the message holds what the command said."""


@dataclass(frozen=True, slots=True)
class Said:
    """What came of a command.

    Attributes:
        code: Its exit code.
        text: What it printed.
    """

    code: int
    text: str

    @property
    def document(self) -> Any:
        """The JSON that it printed last; progress may stand before it."""
        decoder = json.JSONDecoder()
        starts = [i for i, letter in enumerate(self.text) if letter in "{[" and self.text[i - 1 : i] in {"", "\n"}]
        for start in starts:
            try:
                return decoder.raw_decode(self.text[start:])[0]
            except ValueError:
                continue
        raise RehearsalError(f"no JSON in {self.text[-300:]!r}")


@dataclass(slots=True)
class Operator:
    """Types commands in a folder.

    Attributes:
        folder: Where.
        show: Told of every line.
        programs: Run them.
        took_s: How long each command took, with its words.
    """

    folder: Path
    show: Callable[[str], None]
    programs: WarmPrograms
    took_s: list[tuple[str, float]] = field(default_factory=list)

    def types(self, line: str, *, expected: tuple[int, ...] = (0,)) -> Said:
        """Return what a command says.

        Args:
            line: As a person types it; `roadgrip-train` and `roadgrip-rsu` are this installation's.
            expected: Exit codes that are no surprise.

        Raises:
            RehearsalError: It ended with another code.
        """
        self.show(f"$ {line}")
        started_s = time.monotonic()
        done = self.programs.run(shlex.split(line), folder=self.folder, environment={"COLUMNS": "140"})
        self.took_s.append((line, time.monotonic() - started_s))
        if done.returncode not in expected:
            last = (done.stderr.strip() or done.stdout.strip()).splitlines()[-12:]
            raise RehearsalError(f"{line}\nended with code {done.returncode}:\n" + "\n".join(last))
        return Said(done.returncode, done.stdout)
