"""An export on its way into a file: without the order of arrival, packed, and whole or not at all."""

from __future__ import annotations

import gzip
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import groupby, islice
from math import floor
from pathlib import Path
from random import Random
from typing import IO

from roadgrip.errors import RoadgripError
from roadgrip.passage_export import TIME_STEP_S, ExportedPassage, ExportHead, head_to_json, passage_to_json

SHUFFLED_COUNT = 10_000
"""Passages of one time step that are shuffled at once; bounds memory, and no section sees so many in ten seconds."""


class ExportFailedError(RoadgripError):
    """An export that cannot be made; the message says why."""


def step_before(unix_s: float) -> float:
    """Return the newest step of time at or before a moment: a finer bound would tell when a passage came in."""
    return TIME_STEP_S * floor(unix_s / TIME_STEP_S)


def shuffled(passages: Iterable[ExportedPassage], *, rng: Random) -> Iterator[ExportedPassage]:
    """Yield passages so that their order tells no more about who came first than their times do.

    Args:
        passages: By section, and within one by the moment of leaving it.
        rng: Chance.
    """
    for _, together in groupby(passages, key=lambda passage: (passage.section_id, passage.left_unix_s)):
        while batch := list(islice(together, SHUFFLED_COUNT)):
            rng.shuffle(batch)
            yield from batch


def write_export(
    path: Path,
    head: ExportHead,
    passages: Iterable[ExportedPassage],
    *,
    rng: Random,
    on_written: Callable[[int], None] = lambda _: None,
) -> int:
    """Return how many passages were written; the file is there, whole and on the disk, or as it was before.

    Args:
        path: Of the file.
        head: What is said once.
        passages: By section, and within one by the moment of leaving it.
        rng: Shuffles what left a section in the same step of time.
        on_written: Is told how many were written so far, after each.

    Raises:
        ExportFailedError: The file cannot be written.
    """
    count = 0
    with (
        _whole_file(path) as file,
        # Without a name and a time of its own, which gzip would keep.
        gzip.GzipFile(filename="", mode="wb", fileobj=file, mtime=0) as packed,
    ):
        packed.write(f"{head_to_json(head)}\n".encode())
        for count, passage in enumerate(shuffled(passages, rng=rng), start=1):
            packed.write(f"{passage_to_json(passage)}\n".encode())
            on_written(count)
    return count


@contextmanager
def _whole_file(path: Path) -> Iterator[IO[bytes]]:
    """Give a file that takes its name when it is whole; only the account that writes it may read it."""
    part: Path | None = None
    try:
        with tempfile.NamedTemporaryFile(
            dir=path.parent, prefix=f".{path.name}.", suffix=".part", delete=False
        ) as file:
            part = Path(file.name)
            yield file
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        raise ExportFailedError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        if part is not None:
            part.unlink(missing_ok=True)
