"""Passages that units exported: files become records, and lines that hold none are refused.

What becomes of a passage that is to be learned from, `training.data.measured_passages` says.
"""

from __future__ import annotations

import gzip
import hashlib
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from roadgrip.passage_export import ExportedPassage, ExportError, ExportHead, head_from_json, passage_from_json

_GZIP_MAGIC = b"\x1f\x8b"


class PassageReason(StrEnum):
    """Why an exported passage is no row."""

    # What the unit itself would refuse, by the same names.
    MALFORMED = "malformed"
    WRONG_FEATURE_TABLE = "wrong_feature_table"
    STALE_MAP = "stale_map"
    NOT_FINITE = "not_finite"
    OUT_OF_RANGE = "out_of_range"
    IMPOSSIBLE_DURATION = "impossible_duration"
    # What only the laboratory asks.
    NO_MEASUREMENT = "no_measurement"
    SEVERAL_MEASUREMENTS = "several_measurements"
    NO_MAP = "no_map"
    QUALITY = "quality"
    OLDER_TABLE = "older_table"
    REPEATED = "repeated"


@dataclass(frozen=True, slots=True)
class RefusedPassage:
    """A line of an export that is no row.

    Attributes:
        export: Name of the file.
        line_number: In it, from 1; the head is line 1.
        reason: Why, for machines.
        message: Why, for a person.
    """

    export: str
    line_number: int
    reason: PassageReason
    message: str


@dataclass(frozen=True, slots=True)
class Export:
    """An export that was read.

    Attributes:
        name: Of the file.
        digest: Sixteen hexadecimal characters that name its text.
        head: What is said once.
        passages: Its passages by their line numbers.
        refused: Lines that hold none.
    """

    name: str
    digest: str
    head: ExportHead
    passages: Mapping[int, ExportedPassage]
    refused: tuple[RefusedPassage, ...]


def read_export(path: Path) -> Export:
    """Return what a file of exported passages holds, compressed by gzip or not.

    Raises:
        ExportError: It is no export, or was cut short.
        OSError: It cannot be read.
    """
    digest = hashlib.sha256()
    passages: dict[int, ExportedPassage] = {}
    refused: list[RefusedPassage] = []
    head: ExportHead | None = None
    for number, line in enumerate(_lines(path), start=1):
        digest.update(line)
        try:
            text = line.decode("utf-8")
            if head is None:
                head = head_from_json(text)
            elif text.strip():
                passages[number] = passage_from_json(text)
        except (ExportError, UnicodeDecodeError, RecursionError, OverflowError) as error:
            if head is None:
                raise ExportError(f"{path}: {error}") from error
            refused.append(RefusedPassage(path.name, number, PassageReason.MALFORMED, str(error)))
    if head is None:
        raise ExportError(f"{path} is empty")
    return Export(path.name, digest.hexdigest()[:16], head, passages, tuple(refused))


def _lines(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        compressed = file.read(2) == _GZIP_MAGIC
        file.seek(0)
        try:
            yield from gzip.GzipFile(fileobj=file) if compressed else file
        except (EOFError, gzip.BadGzipFile, zlib.error) as error:
            raise ExportError(f"{path} was cut short or damaged: {error}") from error
