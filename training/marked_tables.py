"""Pages whose tables are made from kept figures: the page marks where each goes, a maker writes it anew."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

from training.rounding import rounded

_MARKED = re.compile(r"(<!-- table: ([a-z_.]+) -->\n)(.*?)(<!-- end of table -->)", re.DOTALL)
_DIGITS_COUNT = 4


def with_tables(page: str, table_named: Callable[[str], str | None]) -> str:
    """Return a page with its marked tables written anew.

    Args:
        page: Markdown with `<!-- table: name -->` and `<!-- end of table -->` around every table.
        table_named: Gives the table of a name; None leaves the page's as it is.
    """

    def written(found: re.Match[str]) -> str:
        table = table_named(found[2])
        return found[0] if table is None else f"{found[1]}\n{table}\n{found[4]}"

    return _MARKED.sub(written, page)


def marks_of(page: str) -> list[str]:
    """Return the names of the tables that a page asks for."""
    return [found[2] for found in _MARKED.finditer(page)]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown.

    Args:
        head: One text per column.
        rows: As many texts each.
    """
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    return "\n".join(lines + [f"| {' | '.join(row)} |" for row in rows]) + "\n"


def percent(ratio: float, *, digits: int = 1) -> str:
    """Return a ratio as text in per cent."""
    return f"{100.0 * ratio:.{digits}f} %"


def in_four_digits(figures: Any) -> Any:
    """Return figures as pages tell them, whatever holds them."""
    return rounded(figures, digits_count=_DIGITS_COUNT)
