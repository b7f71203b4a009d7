"""What a unit gives to the laboratory: the passages it stored, without anything that tells one vehicle from another.

An export is text, one JSON object a line: a head with the maps that were driven, then a line per passage. Left out are
the passage's id and digests; times are rounded to ten seconds, which a friction trailer's time span does not notice.
The values of a summary are kept bit by bit, for the laboratory shall learn from what the model was asked.
"""

from __future__ import annotations

import base64
import binascii
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roadgrip.errors import RoadgripError

FORMAT = "roadgrip-passages"
FORMAT_VERSION = 1
TIME_STEP_S = 10.0
"""Moments are told as multiples of this."""


class ExportError(RoadgripError):
    """A text that is no export; the message says where."""


@dataclass(frozen=True, slots=True)
class ExportHead:
    """What is said once in an export.

    Attributes:
        unit: Name of the unit.
        exported_unix_s: When, by its wall clock.
        since_unix_s: Passages received from then on,
        until_unix_s: and before this.
        sections_json: Each map that is served, as `roadgrip.section_file` writes it, by its version.
        bundle_id: The live bundle.
        ledger_hash: Head of the unit's ledger; empty before its first entry.
        software: Version of the unit's software.
    """

    unit: str
    exported_unix_s: float
    since_unix_s: float
    until_unix_s: float
    sections_json: Mapping[str, str]
    bundle_id: str
    ledger_hash: str
    software: str


@dataclass(frozen=True, slots=True, eq=False)
class ExportedPassage:
    """A passage as the unit stored it.

    Attributes:
        section_id: Where.
        map_version: By which map.
        table_digest: The feature table of the values.
        values: The summary, in the order of that table's kinematic features. (n,)
        duration_s: Time over the section.
        quality: Quality flags of the vehicle, as a number.
        left_unix_s: When it left the section, to `TIME_STEP_S`.
        bundle_id: Whose estimate follows.
        mu: The estimate; None when the model gave no number.
        flags: Why it did not count, as a number; 0 if it did.
        expected_error_ratio: The error to expect; None when the bundle does not say.
        mu_low: Below this the friction hardly is; None when the bundle does not say.
        at_least: It only says that the friction is at least `mu_low`.
        shadow_bundle_id: The bundle that was asked beside it; None without one.
        shadow_mu: What that one said; None without an answer.
    """

    section_id: str
    map_version: str
    table_digest: str
    values: NDArray[np.float32]
    duration_s: float
    quality: int
    left_unix_s: float
    bundle_id: str
    mu: float | None
    flags: int
    expected_error_ratio: float | None
    mu_low: float | None
    at_least: bool
    shadow_bundle_id: str | None
    shadow_mu: float | None


def coarse_unix_s(unix_s: float) -> float:
    """Return a moment as an export tells it."""
    return TIME_STEP_S * round(unix_s / TIME_STEP_S)


def head_to_json(head: ExportHead) -> str:
    """Return the first line of an export, without its line feed."""
    said = {name: getattr(head, name) for name in ExportHead.__slots__}
    return json.dumps(
        {"format": FORMAT, "format_version": FORMAT_VERSION, **said, "sections_json": dict(head.sections_json)}
    )


def head_from_json(line: str) -> ExportHead:
    """Return what the first line of an export says.

    Raises:
        ExportError: The text is no export, or of another format.
    """
    raw = _object(line, "the head")
    if raw.get("format") != FORMAT or raw.get("format_version") != FORMAT_VERSION:
        raise ExportError(
            f"format {raw.get('format')!r} {raw.get('format_version')!r}, this software reads {FORMAT} {FORMAT_VERSION}"
        )
    try:
        return ExportHead(
            unit=str(raw["unit"]),
            exported_unix_s=float(raw["exported_unix_s"]),
            since_unix_s=float(raw["since_unix_s"]),
            until_unix_s=float(raw["until_unix_s"]),
            sections_json={str(version): str(text) for version, text in raw["sections_json"].items()},
            bundle_id=str(raw["bundle_id"]),
            ledger_hash=str(raw["ledger_hash"]),
            software=str(raw["software"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ExportError(f"the head of the export: {type(error).__name__} at {error}") from error


def passage_to_json(passage: ExportedPassage) -> str:
    """Return the line of a passage, without its line feed."""
    said = {name: getattr(passage, name) for name in ExportedPassage.__slots__ if name != "values"}
    values = base64.b64encode(np.asarray(passage.values, dtype="<f4").tobytes()).decode()
    return json.dumps({**said, "values_base64_f4": values})


def passage_from_json(line: str) -> ExportedPassage:
    """Return the passage that a line of an export holds.

    Raises:
        ExportError: It holds none.
    """
    raw = _object(line, "a passage")
    try:
        content = base64.b64decode(raw["values_base64_f4"], validate=True)
        return ExportedPassage(
            section_id=str(raw["section_id"]),
            map_version=str(raw["map_version"]),
            table_digest=str(raw["table_digest"]),
            values=np.frombuffer(content, dtype="<f4").astype(np.float32),
            duration_s=float(raw["duration_s"]),
            quality=int(raw["quality"]),
            left_unix_s=float(raw["left_unix_s"]),
            bundle_id=str(raw["bundle_id"]),
            mu=_number_or_none(raw["mu"]),
            flags=int(raw["flags"]),
            expected_error_ratio=_number_or_none(raw["expected_error_ratio"]),
            mu_low=_number_or_none(raw["mu_low"]),
            at_least=bool(raw["at_least"]),
            shadow_bundle_id=None if raw["shadow_bundle_id"] is None else str(raw["shadow_bundle_id"]),
            shadow_mu=_number_or_none(raw["shadow_mu"]),
        )
    except (KeyError, TypeError, ValueError, OverflowError, binascii.Error) as error:
        raise ExportError(f"a passage of the export: {type(error).__name__} at {error}") from error


def _object(line: str, what: str) -> dict[str, Any]:
    try:
        raw = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ExportError(f"{what} of the export is no JSON: {error}") from error
    if not isinstance(raw, dict):
        raise ExportError(f"{what} of the export is no object")
    return raw


def _number_or_none(raw: Any) -> float | None:
    return None if raw is None else float(raw)
