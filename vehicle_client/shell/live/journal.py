"""What the client writes about itself: one JSON line per passage, counters now and then; nothing that names a car."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

from roadgrip.records import Accepted, NotCounted, QualityFlag, Rejected

if TYPE_CHECKING:
    from vehicle_client.pipeline import Summarised
    from vehicle_client.shell.exchange import ExchangeRecord

Write: TypeAlias = Callable[[str], None]
"""Takes one line."""


def passage_entry(
    section_id: str, record: ExchangeRecord, made: Summarised | None, *, via: str, late: bool, age_s: float | None
) -> dict[str, Any]:
    """Return the line about a passage.

    The passage's id is left out: it ties the frames of one exchange together, and with it a log that leaves the car
    would tell which of a unit's passages were this car's.

    Args:
        section_id: The section.
        record: How its exchange went.
        made: What the pipeline made of it, if it was this time.
        via: How the unit was reached: `udp`, `http`, `https`, or `none`.
        late: Whether the summary came from the spool.
        age_s: Time since the car left the section.
    """
    outcome = record.outcome
    entry: dict[str, Any] = {
        "event": "passage",
        "section_id": section_id,
        "ending": record.ending.value,
        "reason": outcome.reason.value if isinstance(outcome, Rejected) else None,
        "withheld": None if record.withheld is None else record.withheld.value,
        "counted": isinstance(outcome, Accepted) and outcome.counted,
        "not_counted": _flags(outcome.flags) if isinstance(outcome, Accepted) else [],
        "spooled": record.may_spool,
        "late": late,
        "via": via,
        "age_s": None if age_s is None else round(age_s, 1),
        "frames_sent_count": record.frames_sent_count,
        "frames_received_count": record.frames_received_count,
        "frames_refused_count": record.frames_refused_count,
        "refusals": {reason.value: count for reason, count in sorted(record.refusals.items())},
        "messages_ignored_count": record.messages_ignored_count,
        "advised_speed_mps": None if record.advisory is None else round(record.advisory.speed_mps, 2),
    }
    if made is not None:
        entry |= {
            "duration_s": round(made.summary.duration_s, 2),
            "quality": _flags(made.summary.quality),
            "method": made.match.method.value,
            "confidence_frac": round(made.match.confidence_frac, 3),
        }
    return entry


class Journal:
    """Writes lines and counts what they say."""

    def __init__(self, write: Write) -> None:
        """Take where lines go."""
        self._write = write
        self.counts: Counter[str] = Counter()

    def passage(self, entry: dict[str, Any]) -> None:
        """Write and count a passage."""
        late = "late_" if entry["late"] else ""
        self.counts[f"passages_{late}{entry['ending']}"] += 1
        told = entry["withheld"] or entry["reason"]
        if told is not None:
            self.counts[f"passages_{late}{entry['ending']}_{told}"] += 1
        self.counts["frames_refused"] += entry["frames_refused_count"]
        for reason, count in entry["refusals"].items():
            self.counts[f"frames_refused_{reason}"] += count
        self.counts["messages_ignored"] += entry["messages_ignored_count"]
        if entry["spooled"] and not entry["late"]:
            self.counts["passages_spooled"] += 1
        self.say(entry)

    def say(self, entry: dict[str, Any]) -> None:
        """Write a line."""
        self._write(json.dumps(entry, separators=(",", ":")))


def _flags(flags: QualityFlag | NotCounted) -> list[str]:
    return [flag.name.lower() for flag in flags if flag.name]
