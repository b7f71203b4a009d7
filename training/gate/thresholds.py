"""What a challenger must do to pass the gate: one TOML file, `thresholds.toml` by default; docs/gate.md says why."""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from roadgrip.errors import RoadgripError

HoldOutRole = str
ROLES: tuple[HoldOutRole, ...] = ("known_roads", "unseen_roads", "manoeuvres", "measured")
"""What hold-outs are for, as `training.data.data_shelf` names it."""
ORDINARY_ROLES = ROLES[:2]
"""Ordinary drivers on ordinary roads: what a unit publishes rests on such."""
MANOEUVRES_ROLE, MEASURED_ROLE = ROLES[2:]

RecordT = TypeVar("RecordT")


class ThresholdsError(RoadgripError):
    """Thresholds that cannot be used; the message says which."""


@dataclass(frozen=True, slots=True)
class HoldOutThresholds:
    """Which hold-outs there must be; see thresholds.toml for every figure here and below."""

    required: tuple[str, ...]
    fewest_rows_count: int
    unanswered_frac: float


@dataclass(frozen=True, slots=True)
class PairedThresholds:
    """The error, challenger against champion."""

    replicates_count: int
    confidence_frac: float
    fewest_sections_count: int
    tolerance_ratio: Mapping[str, float]
    alone_ratio: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class GroupThresholds:
    """The error of the group that fares worst."""

    fewest_rows_count: int
    worse_ratio: float
    allowance_ratio: float
    alone_ratio: float


@dataclass(frozen=True, slots=True)
class IntervalThresholds:
    """The error of the interval that a unit publishes."""

    passages_count: int
    batches_count: int
    fewest_rows_count: int
    worse_ratio: float
    allowance_ratio: float
    alone_mean_ratio: float
    alone_p95_ratio: float


@dataclass(frozen=True, slots=True)
class CalibrationThresholds:
    """How often what is said of single passages holds."""

    required: bool
    shortfall_frac: float
    group_shortfall_frac: float
    highest_frac: float
    fewest_rows_count: int
    lowest_expected_ratio: float
    highest_expected_ratio: float


@dataclass(frozen=True, slots=True)
class ParityThresholds:
    """How far an export may be from its trees."""

    required: bool
    rows_count: int
    tolerance_mu: float


@dataclass(frozen=True, slots=True)
class SpeedThresholds:
    """How long answers may take, and how large the files may be."""

    calls_count: int
    opening_median_s: float
    opening_p99_s: float
    row_s: float
    worse_ratio: float
    allowance_s: float
    most_bytes: int
    worse_size_ratio: float
    allowance_bytes: int


@dataclass(frozen=True, slots=True)
class MonotoneThresholds:
    """How far the estimate may rise with the slip."""

    factors_ratio: tuple[float, ...]
    mean_rise_ratio: float
    steep_rise_ratio: float
    steep_frac: float
    most_rows_count: int


@dataclass(frozen=True, slots=True)
class EnvelopeThresholds:
    """What is to be called strange, and what is not."""

    ordinary_frac: float
    manoeuvres_frac: float


@dataclass(frozen=True, slots=True)
class MeasuredThresholds:
    """How far estimates may be from measured friction."""

    required_from_count: int
    bias_ratio: float
    error_ratio: float
    error_sds_ratio: float


@dataclass(frozen=True, slots=True)
class OlderTablesThresholds:
    """What is asked of models for older feature tables."""

    slack_ratio: float


@dataclass(frozen=True, slots=True)
class DriftThresholds:
    """When a feature of a hold-out is distributed otherwise than in training."""

    flagged_ratio: float
    fewest_rows_count: int


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Everything the gate asks for, by what it asks of."""

    holdouts: HoldOutThresholds
    paired: PairedThresholds
    groups: GroupThresholds
    interval: IntervalThresholds
    calibration: CalibrationThresholds
    parity: ParityThresholds
    speed: SpeedThresholds
    monotone: MonotoneThresholds
    envelope: EnvelopeThresholds
    measured: MeasuredThresholds
    older_tables: OlderTablesThresholds
    drift: DriftThresholds


def default_thresholds() -> Thresholds:
    """Return the thresholds that come with roadgrip."""
    return thresholds_from_toml((files("training.gate") / "thresholds.toml").read_text(encoding="utf-8"))


def read_thresholds(path: Path) -> Thresholds:
    """Return the thresholds of a file.

    Raises:
        ThresholdsError: It cannot be read, or is not whole.
    """
    try:
        return thresholds_from_toml(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ThresholdsError) as error:
        raise ThresholdsError(f"{path}: {error}") from error


def thresholds_from_toml(text: str) -> Thresholds:
    """Return the thresholds that a TOML text holds, all of them and no others: a word that is misspelt is no default.

    Raises:
        ThresholdsError: The text is no TOML, lacks a threshold, or has one that nobody asks for.
    """
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ThresholdsError(f"no TOML: {error}") from error
    return thresholds_from_document(document)


def thresholds_from_document(document: Mapping[str, Any]) -> Thresholds:
    """Return the thresholds of a document as TOML and JSON have it; see `thresholds_from_toml`."""
    made = _record(Thresholds, document, place="")
    if unknown := set(made.holdouts.required) - set(ROLES):
        raise ThresholdsError(f"holdouts.required: {', '.join(sorted(unknown))} is none of {', '.join(ROLES)}")
    for name in ("tolerance_ratio", "alone_ratio"):
        if set(getattr(made.paired, name)) != set(ROLES):
            raise ThresholdsError(f"paired.{name} needs a figure for each of {', '.join(ROLES)}")
    if not made.monotone.factors_ratio or min(made.monotone.factors_ratio) <= 1.0:
        raise ThresholdsError("monotone.factors_ratio: more slip is a factor above one")
    if made.paired.replicates_count < 1 or not 0.5 <= made.paired.confidence_frac < 1.0:
        raise ThresholdsError("paired: a bound needs replicates, and a confidence from 0.5 to below 1")
    return made


def thresholds_document(thresholds: Thresholds) -> dict[str, Any]:
    """Return thresholds as JSON has them; `thresholds_from_document` reads them back."""
    document: dict[str, Any] = json.loads(json.dumps(asdict(thresholds), default=dict))
    return document


def thresholds_sha256(thresholds: Thresholds) -> str:
    """Return what names the thresholds: SHA-256 of their values, whatever the file looked like."""
    text = json.dumps(thresholds_document(thresholds), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _record(kind: type[RecordT], raw: Any, *, place: str) -> RecordT:
    if not isinstance(raw, Mapping):
        raise ThresholdsError(f"{place or 'thresholds'} must be a table")
    kinds = get_type_hints(kind)
    names = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    prefix = f"{place}." if place else ""
    for what, found in (("is missing", names - set(raw)), ("is asked by nobody", set(raw) - names)):
        if found:
            raise ThresholdsError(f"{prefix}{min(found)} {what}")
    return kind(**{name: _value(kinds[name], raw[name], place=f"{prefix}{name}") for name in sorted(names)})


def _value(kind: Any, raw: Any, *, place: str) -> Any:
    if kind is bool:
        return _checked(raw, isinstance(raw, bool), place, "true or false")
    if kind is int:
        return _checked(raw, _is_number(raw) and raw == int(raw), place, "a whole number, zero or more")
    if kind is float:
        return float(_checked(raw, _is_number(raw), place, "a number, zero or more"))
    if kind == tuple[str, ...]:
        is_list = isinstance(raw, list | tuple) and all(isinstance(each, str) for each in raw)
        return tuple(_checked(raw, is_list, place, "a list of words"))
    if kind == tuple[float, ...]:
        is_list = isinstance(raw, list | tuple) and all(map(_is_number, raw))
        return tuple(float(each) for each in _checked(raw, is_list, place, "a list of numbers"))
    if kind == Mapping[str, float]:
        is_table = isinstance(raw, Mapping) and all(map(_is_number, raw.values()))
        return {name: float(each) for name, each in _checked(raw, is_table, place, "numbers by name").items()}
    return _record(kind, raw, place=place)


def _is_number(raw: Any) -> bool:
    return isinstance(raw, int | float) and not isinstance(raw, bool) and math.isfinite(raw) and raw >= 0.0


def _checked(raw: Any, fits: bool, place: str, wanted: str) -> Any:  # noqa: FBT001 - reads as a sentence
    if not fits:
        raise ThresholdsError(f"{place} must be {wanted}, not {raw!r:.40}")
    return raw
