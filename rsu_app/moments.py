"""Moments as people write and read them: ISO 8601, in UTC unless they say otherwise."""

from __future__ import annotations

from datetime import UTC, datetime


def shown_moment(unix_s: float) -> str:
    """Return a moment to the second, such as `2026-01-31T06:00:00Z`; the bare number if no calendar has it."""
    try:
        return datetime.fromtimestamp(unix_s, tz=UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
    except (OverflowError, ValueError, OSError):
        return f"{unix_s:g} s"


def unix_s_of(text: str) -> float:
    """Return the moment that a text names; a day alone is its midnight.

    Raises:
        ValueError: The text names none.
    """
    moment = datetime.fromisoformat(text)
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
