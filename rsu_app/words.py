"""Sizes and durations as people say them."""

from __future__ import annotations

_KIBI = 1024.0


def size_words(size_bytes: float) -> str:
    """Return a size in the unit that suits it."""
    for unit in ("B", "kB", "MB"):
        if size_bytes < _KIBI:
            return f"{size_bytes:.0f} {unit}" if unit == "B" or size_bytes >= 100.0 else f"{size_bytes:.1f} {unit}"
        size_bytes /= _KIBI
    return f"{size_bytes:.1f} GB"


def duration_words(duration_s: float) -> str:
    """Return a duration in its two largest units."""
    if abs(duration_s) < 60.0:
        return f"{duration_s:.0f} s"
    minutes_count = int(abs(duration_s) // 60)
    if minutes_count < 60:
        words = f"{minutes_count} min"
    elif minutes_count < 24 * 60:
        words = f"{minutes_count // 60} h {minutes_count % 60} min"
    else:
        words = f"{minutes_count // 1440} d {minutes_count % 1440 // 60} h"
    return words if duration_s >= 0.0 else f"-{words}"
