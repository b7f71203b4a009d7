"""A table of a page, from plain values."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any


def html_table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return a table; nothing without a row. Texts are escaped, numbers stand to the right, None is an empty cell."""
    if not rows:
        return ""
    titles = "".join(f"<th>{escape(title)}</th>" for title in head)
    lines = "".join(f"<tr>{''.join(map(_cell, row))}</tr>\n" for row in rows)
    return f"<table><tr>{titles}</tr>\n{lines}</table>"


def _cell(value: Any) -> str:
    if value is None:
        return "<td></td>"
    if isinstance(value, float):
        return f'<td class="number">{value:.4g}</td>'
    if isinstance(value, int):
        return f'<td class="number">{value}</td>'
    return f"<td>{escape(', '.join(value) if isinstance(value, list) else str(value))}</td>"
