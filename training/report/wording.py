"""How the reports say things: numbers to three digits, sizes, names of sensors."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TypeVar

from training.study.chapter import Cell, Claim, Table
from training.study.picture import Picture
from vehicle_client.simulator.plan import SensorGrade

T = TypeVar("T", Table, Picture)

GRADE_TITLES: Mapping[SensorGrade, str] = MappingProxyType(
    {SensorGrade.IDEAL: "Ideal sensors", SensorGrade.AUTOMOTIVE: "Automotive sensors"}
)
CLAIM_MARKS: Mapping[Claim, str] = MappingProxyType(
    {
        Claim.CONFIRMED: "\u2714",
        Claim.PARTLY: "\u25d0",
        Claim.NOT_CONFIRMED: "\u2718",
        Claim.NOT_TESTABLE: "\u2013",
        Claim.NOT_CLAIMED: "\u2605",
    }
)
BOTH_GRADES = "Both grades of sensors"
MISSING = "\u2013"
_DIGITS_COUNT = 3


def cell_text(cell: Cell) -> str:
    """Return a cell as a person reads it: a number to three digits, whole numbers whole, a dash for nothing."""
    if cell is None:
        return MISSING
    if isinstance(cell, str):
        return cell
    if isinstance(cell, int):
        return f"{cell:,}" if abs(cell) >= 10_000 else str(cell)
    return number_text(cell)


def number_text(value: float) -> str:
    """Return a number to three digits, without an exponent where that can be."""
    if not math.isfinite(value):
        return MISSING
    if value == 0.0:
        return "0"
    decimals = max(0, _DIGITS_COUNT - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{decimals}f}" if decimals <= 2 * _DIGITS_COUNT else f"{value:.2e}"


def percent_text(frac: float | None) -> str:
    """Return a fraction in per cent, to three digits."""
    return MISSING if frac is None or not math.isfinite(frac) else f"{number_text(100.0 * frac)} %"


def sizes_text(sizes: Mapping[str, int]) -> str:
    """Return sample sizes in a line."""
    return ", ".join(f"{name.replace('_', ' ')}: {cell_text(count)}" for name, count in sizes.items())


def slug(text: str) -> str:
    """Return a text as part of a file's name."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:60].strip("-")


def is_number(cell: Cell) -> bool:
    """Return whether a cell is set to the right."""
    return isinstance(cell, int | float)


def without_grade(title: str, grade: SensorGrade) -> str:
    """Return a title without the sensors it names, if it does."""
    return re.sub(rf"[,:]? ?\(?(with |by )?\b{grade.value}\b( sensors)?\)?", "", title, flags=re.IGNORECASE).strip()


def pairs_of(shown: Mapping[SensorGrade, Sequence[T]]) -> list[list[tuple[str, T]]]:
    """Return tables or pictures that belong together, in order: those of one title, each under its sensors' name.

    Titles that differ in nothing but the sensors they name are one. What is the same with all grades, since it knows
    nothing of sensors, stands there once.
    """
    by_title: dict[tuple[str, int], dict[SensorGrade, T]] = {}
    for grade, things in shown.items():
        titles: list[str] = []
        for thing in things:
            title = without_grade(thing.title, grade)
            by_title.setdefault((title, titles.count(title)), {})[grade] = thing
            titles.append(title)
    pairs = []
    for pair in by_title.values():
        # Compared as text: what is no number is not even equal to itself.
        if len(pair) > 1 and len({repr(thing) for thing in pair.values()}) == 1:
            pairs.append([(BOTH_GRADES, next(iter(pair.values())))])
        else:
            pairs.append([(GRADE_TITLES[grade], thing) for grade, thing in pair.items()])
    return pairs
