"""What a chapter of the accuracy study is, and how it says that it cannot be made here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

CHAPTERS = ("sideslip", "paper_figure", "filters", "positions", "matching", "recordings", "faults")
"""In the order of the page. Each is a module of its name in this package, with two things in it:

`draw(folder) -> dict`   computes, writes its pictures (SVG) into the folder and returns its figures: plain numbers,
                         texts, lists and dictionaries. Raises `InputMissingError` where it cannot be made.
`TABLES`                 optional; the tables of the page by name, each a function of the chapter's figures. The page
                         marks the place of `TABLES["cells"]` of `sideslip` with `<!-- table: sideslip.cells -->`.
"""
RECORDINGS_FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data" / "vehicle"

Figures = Mapping[str, Any]


class InputMissingError(Exception):
    """What a chapter needs is not on this machine; what is kept of it stays."""


def recordings_folder() -> Path:
    """Return the folder of recorded drives.

    Raises:
        InputMissingError: There is none.
    """
    if not RECORDINGS_FOLDER.is_dir():
        raise InputMissingError("the recordings are not here (../shared/data/vehicle)")
    return RECORDINGS_FOLDER


def drawn(chapter: str, folder: Path) -> dict[str, Any]:
    """Return the figures of a chapter, its pictures written.

    Args:
        chapter: One of `CHAPTERS`.
        folder: Where pictures go.

    Raises:
        InputMissingError: It cannot be made here.
    """
    figures: dict[str, Any] = import_module(f"bench.onboard.{chapter}").draw(folder)
    return figures


def table_maker(chapter: str, table: str) -> Callable[[Figures], str]:
    """Return what writes a table of a chapter from the chapter's figures.

    Raises:
        KeyError: The chapter has no such table.
    """
    makers: Mapping[str, Callable[[Figures], str]] = import_module(f"bench.onboard.{chapter}").TABLES
    return makers[table]
