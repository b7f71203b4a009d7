"""Rollout state <-> JSON text. Reading is strict: what was not written by us in one piece is no state."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, fields
from typing import Any

from roadgrip.errors import RoadgripError
from rsu_app.domain.rollout import FACTORY_ID, RolloutState, ShelvedBundle, Stage

FORMAT_VERSION = 1
_BUNDLE_ID = re.compile(r"[0-9a-f]{16}")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_STATE_KEYS = {"format_version", *(each.name for each in fields(RolloutState))}
_BUNDLE_KEYS = {each.name for each in fields(ShelvedBundle)}


class StateFileError(RoadgripError):
    """A text that is no state of a shelf; the message says why."""


def state_to_json(state: RolloutState) -> str:
    """Return a state as JSON text that `state_from_json` reads back to an equal record."""
    return json.dumps({"format_version": FORMAT_VERSION, **asdict(state)}, indent=1, sort_keys=True) + "\n"


def state_from_json(text: str) -> RolloutState:
    """Return the state that a JSON text holds.

    Raises:
        StateFileError: It holds none, or one that contradicts itself.
    """
    try:
        raw = _object(json.loads(text), _STATE_KEYS)
        if raw["format_version"] != FORMAT_VERSION:
            raise StateFileError(f"state format {raw['format_version']}, this software reads {FORMAT_VERSION}")
        return RolloutState(
            live=_bundle_from(raw["live"]),
            previous=None if raw["previous"] is None else _bundle_from(raw["previous"]),
            candidate=None if raw["candidate"] is None else _bundle_from(raw["candidate"]),
            stage=Stage(raw["stage"]),
            newest_sequence_number=_count(raw["newest_sequence_number"]),
        )
    # Deeply nested brackets end in a RecursionError.
    except (ValueError, RecursionError) as error:
        raise StateFileError(f"not the state of a shelf: {error}") from error


def _bundle_from(raw: Any) -> ShelvedBundle:
    values = _object(raw, _BUNDLE_KEYS)
    bundle = ShelvedBundle(
        bundle_id=_text(values["bundle_id"]),
        manifest_sha256=_text(values["manifest_sha256"]),
        sequence_number=_count(values["sequence_number"]),
        ledger_hash=_text(values["ledger_hash"]),
        gate=_text(values["gate"]),
    )
    # Both become part of a folder's name, so they must not be able to lead elsewhere.
    named = _BUNDLE_ID.fullmatch(bundle.bundle_id) and _SHA256.fullmatch(bundle.manifest_sha256)
    if not named and (bundle.bundle_id, bundle.manifest_sha256) != (FACTORY_ID, ""):
        raise ValueError(f"a bundle is called {bundle.bundle_id!r} with the digest {bundle.manifest_sha256!r}")
    return bundle


def _object(raw: Any, keys: set[str]) -> dict[str, Any]:
    if not isinstance(raw, dict) or set(raw) != keys:
        raise ValueError(f"an object with exactly {sorted(keys)} is wanted")
    return raw


def _text(raw: Any) -> str:
    if not isinstance(raw, str):
        raise ValueError(f"{raw!r} is no text")  # noqa: TRY004 - one kind of error for everything a file can hold
    return raw


def _count(raw: Any) -> int:
    if type(raw) is not int or raw < 0:
        raise ValueError(f"{raw!r} is no number of a release")
    return raw
