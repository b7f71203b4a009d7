"""What a check comes to."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """How bad it is."""

    OK = "ok"
    WARN = "warn"
    """The unit serves; somebody should look."""
    FAIL = "fail"
    """The unit does not do its whole job, or will not after the next start."""


EXIT_CODES = {Level.OK: 0, Level.WARN: 1, Level.FAIL: 2}


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found of one thing.

    Attributes:
        name: Of the thing.
        level: How bad it is.
        seen: What was found.
        remedy: The command or setting that mends it; empty where there is nothing to mend.
    """

    name: str
    level: Level
    seen: str
    remedy: str = ""


def fine(name: str, seen: str) -> Finding:
    """Return that all is well."""
    return Finding(name, Level.OK, seen)


def warned(name: str, seen: str, remedy: str) -> Finding:
    """Return that somebody should look."""
    return Finding(name, Level.WARN, seen, remedy)


def failed(name: str, seen: str, remedy: str) -> Finding:
    """Return that something does not work."""
    return Finding(name, Level.FAIL, seen, remedy)


def exit_code(findings: Iterable[Finding]) -> int:
    """Return 0 if all is well, 1 with warnings, 2 with failures."""
    return max((EXIT_CODES[finding.level] for finding in findings), default=0)
