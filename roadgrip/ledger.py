"""The ledger of a unit or a laboratory: what was done to models, when, by whom and why, in a chain nobody can mend.

Every entry holds the hash of the one before it, so that an entry which is changed, left out or slipped in later breaks
the chain. A chain alone cannot show that its newest entries are missing: for that its head is told elsewhere (in
releases, exports and metrics), and whoever has an old head can ask whether it is still part of the chain.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import pairwise
from math import isfinite
from typing import Any

from roadgrip.errors import RoadgripError

GENESIS_HASH = "0" * 64
"""Stands where the first entry of a ledger would name the one before it."""
TEXT_LIMIT_CHARS = 2_000
"""Longest reason, and longest piece of evidence; a ledger is no place for files."""


class LedgerError(RoadgripError):
    """A ledger that cannot be read or does not hold together; the message says where."""


class Action(StrEnum):
    """What was done."""

    # In the laboratory.
    RETRAINED = "retrained"
    JUDGED = "judged"
    PROMOTED = "promoted"
    KEYS_CHANGED = "keys_changed"
    # In a unit.
    LIVE = "live"
    INSTALLED = "installed"
    SHADOWING = "shadowing"
    SWITCHED = "switched"
    CONFIRMED = "confirmed"
    ROLLED_BACK = "rolled_back"
    REJECTED = "rejected"
    REFUSED = "refused"
    LEDGER_BEGUN = "ledger_begun"
    RESTORED = "restored"


WENT_LIVE = frozenset({Action.LIVE, Action.SWITCHED, Action.ROLLED_BACK})
"""After these a unit answers by the bundle that is their subject."""


@dataclass(frozen=True, slots=True)
class LedgerEntry:
    """One act.

    Attributes:
        sequence_number: 1 for the first entry of a ledger, then one more each time.
        at_unix_s: When, by the wall clock, to the millisecond; not to be relied upon for order.
        actor: Who: a person's account, or the unit itself.
        action: What was done.
        subject: To what: a bundle id, or the name of a key's role.
        reason: Why, for a person.
        evidence: What it rests on, such as the digest of a verdict; names and values are text.
        previous_hash: `entry_hash` of the entry before it.
        entry_hash: SHA-256 over all of the above, in hexadecimal.
    """

    sequence_number: int
    at_unix_s: float
    actor: str
    action: Action
    subject: str
    reason: str
    evidence: Mapping[str, str]
    previous_hash: str
    entry_hash: str = field(default="")


def entry_after(
    previous: LedgerEntry | None,
    *,
    at_unix_s: float,
    actor: str,
    action: Action,
    subject: str,
    reason: str,
    evidence: Mapping[str, str] | None = None,
) -> LedgerEntry:
    """Return the entry that follows another; the first of a ledger follows None.

    Texts beyond `TEXT_LIMIT_CHARS` are cut; a time that is no number becomes zero.
    """
    kept = {str(key): str(value)[:TEXT_LIMIT_CHARS] for key, value in sorted((evidence or {}).items())}
    number, before = (1, GENESIS_HASH) if previous is None else (previous.sequence_number + 1, previous.entry_hash)
    content = (
        number,
        round(at_unix_s, 3) + 0.0 if isfinite(at_unix_s) else 0.0,
        actor,
        action,
        subject,
        reason[:TEXT_LIMIT_CHARS],
        kept,
        before,
    )
    return LedgerEntry(*content, entry_hash=hash_of(LedgerEntry(*content)))


def hash_of(entry: LedgerEntry) -> str:
    """Return the SHA-256 of everything an entry says but its own hash, in hexadecimal."""
    said = [
        entry.sequence_number,
        f"{entry.at_unix_s:.3f}",
        entry.actor,
        entry.action.value,
        entry.subject,
        entry.reason,
        dict(entry.evidence),
        entry.previous_hash,
    ]
    text = json.dumps(said, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()


def chain_problems(entries: Iterable[LedgerEntry], *, known_heads: Iterable[str] = ()) -> list[str]:
    """Return what is wrong with a chain, a line each; nothing if it holds together.

    Args:
        entries: Oldest first. The first may have any number: a budget may have cut what came before it.
        known_heads: Hashes that were its head at some time, as told elsewhere.
    """
    chain = list(entries)
    problems = [
        f"entry {entry.sequence_number} was changed: it does not have its own hash"
        for entry in chain
        if hash_of(entry) != entry.entry_hash
    ]
    if chain and chain[0].sequence_number == 1 and chain[0].previous_hash != GENESIS_HASH:
        problems.append("entry 1 follows another one")
    for before, after in pairwise(chain):
        if after.sequence_number != before.sequence_number + 1:
            problems.append(f"entry {after.sequence_number} follows entry {before.sequence_number}")
        elif after.previous_hash != before.entry_hash:
            problems.append(
                f"entry {after.sequence_number} does not follow entry {before.sequence_number} as it stands"
            )
    hashes = {entry.entry_hash for entry in chain}
    problems += [
        f"the head {head[:16]} that was told elsewhere is missing" for head in known_heads if head not in hashes
    ]
    return problems


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where the answers of a unit came from at some moment.

    Attributes:
        live: The entry that says which bundle was live.
        installed: The entry about its release; None for the bundle that the unit was delivered with.
    """

    live: LedgerEntry
    installed: LedgerEntry | None


def provenance_at(entries: Iterable[LedgerEntry], at_unix_s: float) -> Provenance | None:
    """Return which bundle a unit answered by at a moment, and how it came there; None before the first one.

    Args:
        entries: Of the unit's ledger, oldest first. Their order counts: a clock may have stepped between two of them.
        at_unix_s: The moment, by the unit's wall clock.
    """
    live: LedgerEntry | None = None
    releases: dict[str, LedgerEntry] = {}
    for entry in entries:
        if entry.at_unix_s > at_unix_s:
            break
        if entry.action in WENT_LIVE:
            live = entry
        elif entry.action is Action.INSTALLED:
            releases[entry.subject] = entry
    return None if live is None else Provenance(live, releases.get(live.subject))


def entry_to_json(entry: LedgerEntry) -> str:
    """Return an entry as one line of JSON, without a line feed."""
    return json.dumps(
        {
            "sequence_number": entry.sequence_number,
            "at_unix_s": entry.at_unix_s,
            "actor": entry.actor,
            "action": entry.action.value,
            "subject": entry.subject,
            "reason": entry.reason,
            "evidence": dict(entry.evidence),
            "previous_hash": entry.previous_hash,
            "entry_hash": entry.entry_hash,
        },
        ensure_ascii=False,
    )


def entry_from_json(line: str) -> LedgerEntry:
    """Return the entry that a line of JSON holds; whether it is true is for `chain_problems` to say.

    Raises:
        LedgerError: The line is no entry.
    """
    try:
        raw: dict[str, Any] = json.loads(line)
        return LedgerEntry(
            sequence_number=int(raw["sequence_number"]),
            at_unix_s=float(raw["at_unix_s"]),
            actor=str(raw["actor"]),
            action=Action(raw["action"]),
            subject=str(raw["subject"]),
            reason=str(raw["reason"]),
            evidence={str(key): str(value) for key, value in raw["evidence"].items()},
            previous_hash=str(raw["previous_hash"]),
            entry_hash=str(raw["entry_hash"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise LedgerError(f"not an entry of a ledger: {type(error).__name__} at {error}") from error
