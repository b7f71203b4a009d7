"""What the gate says: checks with figures, limits and a sentence each, as a record, as JSON, and by its digest."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from roadgrip.errors import RoadgripError
from training.gate.thresholds import (
    Thresholds,
    ThresholdsError,
    thresholds_document,
    thresholds_from_document,
    thresholds_sha256,
)
from training.study.documents import document_of_picture, in_short, picture_of
from training.study.picture import Picture

FORMAT_VERSION = 1


class VerdictError(RoadgripError):
    """Something that is no verdict, or one that contradicts itself; the message says where."""


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that was asked.

    Attributes:
        name: What was asked, such as "paired_error".
        subject: Of what: a hold-out and feature table, a model file, or the bundle.
        figures: What was found, by name; what is no finite number is left out.
        limits: What they were held against, by name.
        passed: Whether it is as it should be.
        required: Whether the challenger fails without it; else it informs.
        sentence: For a person.
    """

    name: str
    subject: str
    figures: Mapping[str, float]
    limits: Mapping[str, float]
    passed: bool
    required: bool
    sentence: str

    @property
    def failed(self) -> bool:
        """Whether the challenger fails by it."""
        return self.required and not self.passed


@dataclass(frozen=True, slots=True)
class HeldOut:
    """A hold-out that judged.

    Attributes:
        role: What it is for.
        digest: `Runs.digest` of its rows.
        rows_count: All rows.
        usable_count: Those with a summary and a label.
    """

    role: str
    digest: str
    rows_count: int
    usable_count: int


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the gate says of a challenger.

    Attributes:
        challenger: Its bundle id.
        champion: That of the bundle it was compared with; None without one.
        checks: Everything that was asked.
        holdouts: What judged.
        thresholds: What was asked at least.
        pictures: What is drawn on the page.
        made_unix_s: When.
        software_version: Of roadgrip.
    """

    challenger: str
    champion: str | None
    checks: tuple[Check, ...]
    holdouts: tuple[HeldOut, ...]
    thresholds: Thresholds
    pictures: tuple[Picture, ...]
    made_unix_s: float
    software_version: str

    @property
    def passed(self) -> bool:
        """Whether the challenger may take the champion's place: something was required, and nothing required failed."""
        required = [check for check in self.checks if check.required]
        return bool(required) and all(check.passed for check in required)

    @property
    def failures(self) -> tuple[Check, ...]:
        """What the challenger fails by."""
        return tuple(check for check in self.checks if check.failed)


@dataclass(frozen=True, slots=True)
class Found:
    """What one part of the gate found.

    Attributes:
        checks: What was asked.
        pictures: What is drawn of it.
    """

    checks: tuple[Check, ...]
    pictures: tuple[Picture, ...] = ()


def check_of(
    name: str,
    subject: str,
    *,
    passed: bool,
    sentence: str,
    figures: Mapping[str, float] | None = None,
    limits: Mapping[str, float] | None = None,
    required: bool = True,
) -> Check:
    """Return a check; figures that are no finite numbers are left out, and a sentence says why."""
    return Check(
        name=name,
        subject=subject,
        figures=_finite(figures or {}),
        limits=_finite(limits or {}),
        passed=bool(passed),
        required=required,
        sentence=sentence,
    )


def joined(parts: Iterable[Found]) -> Found:
    """Return what several parts found, in their order."""
    found = list(parts)
    return Found(
        tuple(check for part in found for check in part.checks),
        tuple(picture for part in found for picture in part.pictures),
    )


def in_six_digits(picture: Picture) -> Picture:
    """Return a picture as a verdict keeps it, so that what is read back is what was written."""
    return picture_of(in_short(document_of_picture(picture)))


def in_order(checks: Sequence[Check]) -> list[Check]:
    """Return checks as a person wants them: what fails first, then what informs of something wrong, then the rest."""
    return sorted(checks, key=lambda check: (not check.failed, check.passed, not check.required))


def verdict_to_json(verdict: Verdict) -> str:
    """Return a verdict as JSON text; the same verdict gives the same text, and its digest is that of the text."""
    document = {
        "format_version": FORMAT_VERSION,
        "challenger": verdict.challenger,
        "champion": verdict.champion,
        "passed": verdict.passed,
        "checks": [_plain(check) for check in verdict.checks],
        "holdouts": [_plain(held_out) for held_out in verdict.holdouts],
        "thresholds": thresholds_document(verdict.thresholds),
        "thresholds_sha256": thresholds_sha256(verdict.thresholds),
        "made_unix_s": verdict.made_unix_s,
        "software_version": verdict.software_version,
        "pictures": [document_of_picture(picture) for picture in verdict.pictures],
    }
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def verdict_from_json(text: str) -> Verdict:
    """Return the verdict that a JSON text holds.

    Raises:
        VerdictError: It holds none, or one that contradicts itself: whoever changes "passed" must change a check, too.
    """
    try:
        raw = json.loads(text)
        if raw["format_version"] != FORMAT_VERSION:
            raise VerdictError(f"verdict format {raw['format_version']}, this software reads {FORMAT_VERSION}")
        verdict = Verdict(
            challenger=_text(raw["challenger"]),
            champion=None if raw["champion"] is None else _text(raw["champion"]),
            checks=tuple(_check(each) for each in raw["checks"]),
            holdouts=tuple(_held_out(each) for each in raw["holdouts"]),
            thresholds=thresholds_from_document(raw["thresholds"]),
            pictures=tuple(picture_of(each) for each in raw["pictures"]),
            made_unix_s=_number(raw["made_unix_s"]),
            software_version=_text(raw["software_version"]),
        )
        told = raw["passed"], raw["thresholds_sha256"]
    except (KeyError, TypeError, ValueError, AttributeError, ThresholdsError) as error:
        raise VerdictError(f"no verdict: {type(error).__name__} at {error}") from error
    if told[0] is not verdict.passed:
        raise VerdictError(f"it says passed: {told[0]}, its checks say {verdict.passed}")
    if told[1] != thresholds_sha256(verdict.thresholds):
        raise VerdictError("its thresholds are not those that its digest of them names")
    return verdict


def verdict_digest(verdict: Verdict) -> str:
    """Return what names a verdict: the SHA-256 of its JSON text, as `sha256sum` finds it of the file."""
    return hashlib.sha256(verdict_to_json(verdict).encode()).hexdigest()


def _finite(figures: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in figures.items() if math.isfinite(value)}


def _plain(record: Check | HeldOut) -> dict[str, Any]:
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    return {name: dict(value) if isinstance(value, Mapping) else value for name, value in values.items()}


def _check(raw: Mapping[str, Any]) -> Check:
    _exactly(raw, Check)
    return Check(
        name=_text(raw["name"]),
        subject=_text(raw["subject"]),
        figures={_text(name): _number(value) for name, value in raw["figures"].items()},
        limits={_text(name): _number(value) for name, value in raw["limits"].items()},
        passed=_flag(raw["passed"]),
        required=_flag(raw["required"]),
        sentence=_text(raw["sentence"]),
    )


def _held_out(raw: Mapping[str, Any]) -> HeldOut:
    _exactly(raw, HeldOut)
    return HeldOut(
        role=_text(raw["role"]),
        digest=_text(raw["digest"]),
        rows_count=int(_number(raw["rows_count"])),
        usable_count=int(_number(raw["usable_count"])),
    )


def _exactly(raw: Mapping[str, Any], kind: type[Check | HeldOut]) -> None:
    names = {field.name for field in fields(kind)}
    if set(raw) != names:
        raise VerdictError(f"a {kind.__name__} has {', '.join(sorted(names))}, not {', '.join(sorted(raw))}")


def _text(raw: Any) -> str:
    if not isinstance(raw, str):
        raise VerdictError(f"{raw!r:.40} is no text")
    return raw


def _flag(raw: Any) -> bool:
    if not isinstance(raw, bool):
        raise VerdictError(f"{raw!r:.40} is neither true nor false")
    return raw


def _number(raw: Any) -> float:
    if isinstance(raw, bool) or not isinstance(raw, int | float) or not math.isfinite(raw):
        raise VerdictError(f"{raw!r:.40} is no finite number")
    return float(raw)
