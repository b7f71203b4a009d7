"""What an authority has issued and revoked: a log that only grows, and what it adds up to."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from roadgrip.certificates import Certificate, Role
from roadgrip.errors import ConfigurationError


@dataclass(frozen=True, slots=True)
class Entry:
    """One certificate, as the authority remembers it. Of a pseudonym it does not know whose it is.

    Attributes:
        certificate_id: Hexadecimal.
        authority_id: Whose key has signed it; hexadecimal.
        role: What the holder is.
        name: Of the unit, or of the batch of pseudonyms.
        section_ids: The sections a unit may speak for; empty: all.
        valid_from_unix_s: When it begins.
        valid_until_unix_s: When it ends.
        issued_unix_s: When it was issued.
        revoked_unix_s: When it was revoked, if it was.
        why: Why it was revoked.
    """

    certificate_id: str
    authority_id: str
    role: Role
    name: str
    section_ids: tuple[str, ...]
    valid_from_unix_s: int
    valid_until_unix_s: int
    issued_unix_s: int
    revoked_unix_s: int | None = None
    why: str = ""

    def state(self, *, now_unix_s: float) -> str:
        """Return `revoked`, `ended`, `to come` or `in date`."""
        if self.revoked_unix_s is not None:
            return "revoked"
        if now_unix_s > self.valid_until_unix_s:
            return "ended"
        return "to come" if now_unix_s < self.valid_from_unix_s else "in date"


def issued_event(certificate: Certificate, *, name: str, now_unix_s: int) -> dict[str, Any]:
    """Return the event that says that a certificate was issued."""
    return {
        "event": "issued",
        "at_unix_s": now_unix_s,
        "certificate_id": certificate.certificate_id.hex(),
        "authority_id": certificate.authority_id.hex(),
        "role": certificate.role.value,
        "name": name,
        "section_ids": list(certificate.section_ids),
        "valid_from_unix_s": certificate.valid_from_unix_s,
        "valid_until_unix_s": certificate.valid_until_unix_s,
    }


def revoked_event(certificate_id: str, *, why: str, now_unix_s: int) -> dict[str, Any]:
    """Return the event that says that a certificate was revoked."""
    return {"event": "revoked", "at_unix_s": now_unix_s, "certificate_id": certificate_id, "why": why}


def entries_in(lines: Iterable[str]) -> dict[str, Entry]:
    """Return the certificates that a register tells of, by id, in the order of issue.

    Raises:
        ConfigurationError: A line is none of a register; the message says which.
    """
    entries: dict[str, Entry] = {}
    for number, line in enumerate(lines, start=1):
        try:
            event = json.loads(line)
            if event["event"] == "issued":
                entry = Entry(
                    certificate_id=str(event["certificate_id"]),
                    authority_id=str(event["authority_id"]),
                    role=Role(event["role"]),
                    name=str(event["name"]),
                    section_ids=tuple(map(str, event["section_ids"])),
                    valid_from_unix_s=int(event["valid_from_unix_s"]),
                    valid_until_unix_s=int(event["valid_until_unix_s"]),
                    issued_unix_s=int(event["at_unix_s"]),
                )
                entries[entry.certificate_id] = entry
            else:
                known = entries[event["certificate_id"]]
                entries[known.certificate_id] = replace(
                    known, revoked_unix_s=int(event["at_unix_s"]), why=str(event["why"])
                )
        except (KeyError, TypeError, ValueError, RecursionError, AttributeError) as error:
            raise ConfigurationError(f"line {number} of the register is damaged ({error})") from error
    return entries


def chosen_entries(entries: dict[str, Entry], wanted: Iterable[str]) -> list[Entry]:
    """Return the certificates that are meant by names, ids, or beginnings of ids.

    Raises:
        ConfigurationError: One means none, or a beginning means several.
    """
    chosen: dict[str, Entry] = {}
    for text in wanted:
        named = [entry for entry in entries.values() if entry.name == text]
        begun = [] if named else [entry for entry in entries.values() if entry.certificate_id.startswith(text.lower())]
        if len(begun) > 1:
            raise ConfigurationError(f"{len(begun)} certificates begin with {text!r}; write more of the id")
        if not named and not begun:
            raise ConfigurationError(f"no certificate has the id or name {text!r}")
        chosen |= {entry.certificate_id: entry for entry in (*named, *begun)}
    return list(chosen.values())
