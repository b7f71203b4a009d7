"""Figures with few digits, for documents that people compare."""

from __future__ import annotations

from typing import Any


def rounded(value: Any, *, digits_count: int) -> Any:
    """Return figures with so many digits, whatever holds them; sequences as lists, all else as it is."""
    if isinstance(value, dict):
        return {name: rounded(inner, digits_count=digits_count) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(inner, digits_count=digits_count) for inner in value]
    return float(f"{value:.{digits_count}g}") if isinstance(value, float) else value
