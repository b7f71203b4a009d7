"""What the laboratory's shelves have in common: folders named by their content, put there whole and never changed.

Data sets (`training.data.data_shelf`) and ground truth (`training.data.ground_truth_shelf`) lie on such shelves.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol, TypeVar

from roadgrip.errors import RoadgripError

CARD_FILE_NAME = "card.json"
DIGEST = re.compile(r"[0-9a-f]{16}")
_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")
_SHORTEST_PREFIX_COUNT = 4
_READ_ONLY = 0o444


class ShelfError(RoadgripError):
    """Something that may not go on a shelf, is not there, or is no longer what was put there."""


class Carded(Protocol):
    """What lies on a shelf, by its card."""

    @property
    def name(self) -> str:
        """What people call it."""
        ...

    @property
    def digest(self) -> str:
        """What its content is called."""
        ...


CardT = TypeVar("CardT", bound=Carded)


def check_name(name: str, *, digest: str, held: Sequence[Carded]) -> None:
    """Do nothing if people may call something new on a shelf so.

    Args:
        name: What it shall be called.
        digest: What its content is called.
        held: What lies there.

    Raises:
        ShelfError: It is no short word of lower-case letters, digits, dots, hyphens and underscores, looks like a
            digest, or is what something else is called.
    """
    if not _NAME.fullmatch(name) or DIGEST.fullmatch(name):
        raise ShelfError(
            f"{name!r:.80} is no name: it has 1 to 64 lower-case letters, digits, dots, hyphens and underscores, "
            "begins with a letter or digit, and is not sixteen hexadecimal digits"
        )
    for other in held:
        if other.name == name:
            raise ShelfError(
                f"{name} is the name of {other.digest}, which is never changed; this is {digest}: choose another name"
            )


def check_words(**words: str) -> None:
    """Do nothing if all that has to be said of something is said.

    Raises:
        ShelfError: One of the words is blank; the message names it.
    """
    blank = [name for name, word in words.items() if not word.strip()]
    if blank:
        raise ShelfError(f"what lies on a shelf says where it comes from and who may use it: no {', '.join(blank)}")


def chosen(cards: Sequence[CardT], ref: str, *, what: str) -> CardT:
    """Return the card that is meant by a digest, a name, or the beginning of a digest that begins no other.

    Args:
        cards: All of the shelf.
        ref: Which one.
        what: What lies there, for the message.

    Raises:
        ShelfError: None is meant, or more than one.
    """
    exact = [card for card in cards if ref in {card.digest, card.name}]
    if len(exact) == 1:
        return exact[0]
    begun = [card for card in cards if len(ref) >= _SHORTEST_PREFIX_COUNT and card.digest.startswith(ref)]
    if len(begun) == 1:
        return begun[0]
    if begun:
        raise ShelfError(f"{ref} may be any of {', '.join(card.digest for card in begun)}")
    known = ", ".join(f"{card.name} ({card.digest})" for card in cards) or "none"
    raise ShelfError(f"no {what} {ref!r:.80} on the shelf; there are {known}")


def digests_in(folder: Path) -> list[str]:
    """Return the names of the folders that lie on a shelf, in order; what is half put there is none of them."""
    if not folder.is_dir():
        return []
    return sorted(path.name for path in folder.iterdir() if path.is_dir() and DIGEST.fullmatch(path.name))


def put_on_shelf(place: Path, write: Callable[[Path], None]) -> None:
    """Put a folder on a shelf, whole or not at all, its files on the disk and read-only.

    What is there already stays: its name says that it is the same.

    Args:
        place: Where it shall lie.
        write: Writes its files into an empty folder, given as the argument.
    """
    place.parent.mkdir(parents=True, exist_ok=True)
    partial = place.with_name(f".{place.name}.{os.getpid()}.partial")
    shutil.rmtree(partial, ignore_errors=True)  # of a process of this number that was killed
    partial.mkdir()
    try:
        write(partial)
        for path in partial.iterdir():
            _settle(path)
        try:
            partial.rename(place)
        except OSError:
            # Somebody else was faster: a folder with files in it is not replaced.
            if not place.is_dir():
                raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _settle(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())
    path.chmod(_READ_ONLY)
