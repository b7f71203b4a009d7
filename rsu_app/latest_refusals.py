"""The newest refusals, for whoever stands beside the unit and asks why nothing is counted."""

from __future__ import annotations

from dataclasses import dataclass

KINDS_LIMIT_COUNT = 32
DETAIL_LIMIT_COUNT = 200


@dataclass(frozen=True, slots=True)
class RefusedKind:
    """Refusals of one kind.

    Attributes:
        reason: Their code.
        section: What the sender named, or `other` for a section that is not served; empty where it was not read.
        via: The way they came.
        detail: What was found the last time, for a person.
        refused_count: How many since the start, or since the kind was last forgotten.
        at_s: When the last one came, by the machine's monotonic clock.
    """

    reason: str
    section: str
    via: str
    detail: str
    refused_count: int
    at_s: float


class LatestRefusals:
    """Remembers the kinds of refusals that came last. A flood of one kind pushes out no other.

    Args:
        kinds_limit_count: Kinds that are remembered; the one that was not seen for longest makes room.
    """

    def __init__(self, kinds_limit_count: int = KINDS_LIMIT_COUNT) -> None:
        self._limit_count = kinds_limit_count
        self._kinds: dict[tuple[str, str, str], RefusedKind] = {}

    def note(self, *, reason: str, section: str, via: str, detail: str, now_s: float) -> None:
        """Remember a refusal.

        Args:
            reason: Its code.
            section: Label of the section, of a closed set.
            via: The way it came.
            detail: For a person; cut where it is long, for a sender may have a hand in it.
            now_s: The machine's monotonic clock.
        """
        kind = (reason, section, via)
        earlier = self._kinds.pop(kind, None)
        refused_count = 1 if earlier is None else earlier.refused_count + 1
        self._kinds[kind] = RefusedKind(reason, section, via, detail[:DETAIL_LIMIT_COUNT], refused_count, now_s)
        if len(self._kinds) > self._limit_count:
            del self._kinds[next(iter(self._kinds))]

    def newest(self) -> tuple[RefusedKind, ...]:
        """Return what is remembered, the newest first."""
        return tuple(reversed(self._kinds.values()))
