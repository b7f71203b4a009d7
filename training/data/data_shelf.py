"""Data sets of a laboratory: named by their content, described, never changed, and some of them never learned from.

lab/data/<digest>/
  runs.parquet      the rows (`training.dataset`)
  label_sd_mu.npy   how uncertain each row's label is, where labels were measured
  card.json         what it is, where it comes from, who may use it

A *hold-out* is a data set that only judges. Its role is part of its digest, and `training_sets`, the only way to rows
that are learned from, refuses it and every row that lies in it, whatever data set brings the row along.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TypeVar

import numpy as np

from roadgrip.errors import RoadgripError
from roadgrip.features import PAPER_TABLE
from roadgrip.units import BoolArray, FloatArray
from training.data.shelf import (
    CARD_FILE_NAME,
    ShelfError,
    check_name,
    check_words,
    chosen,
    digests_in,
    put_on_shelf,
)
from training.dataset import RUNS_FILE_NAME, Runs, read_runs, write_runs
from training.laboratory import Laboratory

LABEL_SD_FILE_NAME = "label_sd_mu.npy"
LABEL_LIMIT_MU = 1.5
"""No road gives a tyre more."""
_NAMED_COUNT = 5
"""So many rows are named in a message; the others are counted."""

EnumT = TypeVar("EnumT", bound=StrEnum)


class HoldOutError(ShelfError):
    """Something that must not be learned from, because it judges; the message says what."""


class DataKind(StrEnum):
    """Where the labels come from."""

    SIMULATED = "simulated"
    MEASURED = "measured"


class Role(StrEnum):
    """What a data set is for."""

    TRAINING = "training"
    # Hold-outs: they judge, and are never learned from.
    KNOWN_ROADS = "known_roads"
    UNSEEN_ROADS = "unseen_roads"
    MANOEUVRES = "manoeuvres"
    MEASURED = "measured"

    @property
    def is_hold_out(self) -> bool:
        """Whether nothing may be learned from such a data set."""
        return self is not Role.TRAINING


@dataclass(frozen=True, slots=True)
class DataCard:
    """What a data set says of itself.

    Attributes:
        name: What people call it; no two on a shelf are called the same.
        digest: Sixteen hexadecimal characters that name rows, uncertainty of the labels, and role.
        kind: Where the labels come from.
        role: What it is for.
        origin: Who or what made it, for a person.
        licence: Who may do what with it.
        label_kind: What a label is, such as "simulated friction" or "trailer measurement".
        table_digest: The feature table of the rows.
        rows_count: All rows.
        usable_count: Those with a summary and a label.
        sections: The sections that were driven, in order.
        added_unix_s: When it was put on the shelf.
        made_from: What it came from: digests, commands, options, by what they are.
    """

    name: str
    digest: str
    kind: DataKind
    role: Role
    origin: str
    licence: str
    label_kind: str
    table_digest: str
    rows_count: int
    usable_count: int
    sections: tuple[str, ...]
    added_unix_s: float
    made_from: Mapping[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class DataSet:
    """A data set as it lies on the shelf.

    Attributes:
        card: What it says of itself.
        runs: The rows.
        label_sd_mu: Standard deviation of each row's label; None where labels are exact. (n,)
    """

    card: DataCard
    runs: Runs
    label_sd_mu: FloatArray | None = None


def add_data_set(
    lab: Laboratory,
    runs: Runs,
    *,
    name: str,
    kind: str,
    role: str,
    origin: str,
    licence: str,
    label_kind: str,
    label_sd_mu: FloatArray | None = None,
    made_from: Mapping[str, str] | None = None,
    now_unix_s: float | None = None,
) -> DataCard:
    """Return the card of a data set that was put on the shelf; the same content again gives the card it has.

    Args:
        lab: Whose shelf.
        runs: The rows, at least one of them usable.
        name: What people shall call it.
        kind: One of `DataKind`.
        role: One of `Role`.
        origin: Who or what made it.
        licence: Who may do what with it.
        label_kind: What a label is.
        label_sd_mu: Standard deviation of each row's label; None where labels are exact. (n,)
        made_from: What it came from.
        now_unix_s: When; now by default.

    Raises:
        ShelfError: Something is missing or cannot be, or another data set has the name.
    """
    card = DataCard(
        name=name,
        digest=content_digest(runs, label_sd_mu, role=role),
        kind=_one_of(DataKind, kind),
        role=_one_of(Role, role),
        origin=origin,
        licence=licence,
        label_kind=label_kind,
        table_digest=runs.table.digest,
        rows_count=len(runs),
        usable_count=int(runs.usable.sum()),
        sections=tuple(sorted(set(runs.section_id))),
        added_unix_s=time.time() if now_unix_s is None else now_unix_s,
        made_from=dict(made_from or {}),
    )
    held = data_cards(lab)
    for other in held:
        if other.digest == card.digest:
            return other
    _check_card(card, held)
    _check_labels(runs, label_sd_mu)
    put_on_shelf(lab.data_folder / card.digest, lambda folder: _write(folder, card, runs, label_sd_mu))
    return card


def read_data_set(lab: Laboratory, ref: str) -> DataSet:
    """Return a data set of the shelf whose content still is what its digest names.

    Args:
        lab: Whose shelf.
        ref: Digest, name, or beginning of a digest.

    Raises:
        ShelfError: It is not there, or has changed.
    """
    card = _chosen(lab, ref)
    folder = lab.data_folder / card.digest
    try:
        runs = read_runs(folder / RUNS_FILE_NAME)
        path = folder / LABEL_SD_FILE_NAME
        label_sd_mu = np.load(path, allow_pickle=False) if path.is_file() else None
        found = content_digest(runs, label_sd_mu, role=card.role)
    except (RoadgripError, OSError, ValueError) as error:
        raise ShelfError(f"data set {card.name} ({card.digest}) cannot be read: {error}") from error
    told = (card.digest, card.table_digest, card.rows_count, card.usable_count)
    if told != (found, runs.table.digest, len(runs), int(runs.usable.sum())):
        raise ShelfError(
            f"data set {card.name} ({card.digest}) has changed since it was put on the shelf: its content is {found}, "
            f"{len(runs)} rows of feature table {runs.table.digest}; nothing may rest on it"
        )
    return DataSet(card, runs, label_sd_mu)


def data_cards(lab: Laboratory) -> list[DataCard]:
    """Return the cards of all data sets on the shelf, oldest first.

    Raises:
        ShelfError: A card cannot be read.
    """
    cards = [_read_card(lab.data_folder / digest) for digest in digests_in(lab.data_folder)]
    return sorted(cards, key=lambda card: (card.added_unix_s, card.digest))


def training_sets(lab: Laboratory, refs: Sequence[str]) -> list[DataSet]:
    """Return data sets to learn from, none of whose rows judges.

    Two rows are the same passage when what the vehicle told is, in the 32-bit numbers of the oldest feature table:
    whichever table and map the data sets are of. A road of a hold-out of unseen roads must not be learned from either,
    whoever drove it.

    Args:
        lab: Whose shelf.
        refs: Digests, names, or beginnings of digests; at least one.

    Raises:
        HoldOutError: One is a hold-out, or shares rows or unseen roads with a hold-out of the shelf.
        ShelfError: One is not there, has changed, or is named twice.
    """
    if not refs:
        raise ShelfError("no data set is named: there is nothing to learn from")
    cards = [_chosen(lab, ref) for ref in refs]
    if len({card.digest for card in cards}) < len(cards):
        raise ShelfError(f"a data set is named twice: {', '.join(card.name for card in cards)}")
    for card in cards:
        if card.role.is_hold_out:
            raise HoldOutError(f"{card.name} ({card.digest}) is the hold-out {card.role}: it judges, and never teaches")
    data_sets = [read_data_set(lab, card.digest) for card in cards]
    for judging in data_cards(lab):
        if judging.role.is_hold_out:
            held_out = read_data_set(lab, judging.digest)
            for data_set in data_sets:
                _check_apart(data_set, held_out)
    return data_sets


def content_digest(runs: Runs, label_sd_mu: FloatArray | None, *, role: str) -> str:
    """Return sixteen hexadecimal characters that name rows, uncertainty of their labels and role.

    The order of the rows does not matter where their keys differ.
    """
    digest = hashlib.sha256(f"roadgrip data set|{runs.digest()}|{role}".encode())
    if label_sd_mu is not None:
        _check_size(runs, label_sd_mu)
        order = np.argsort(np.array(runs.run_key), kind="stable")
        digest.update(b"|label_sd_mu|" + label_sd_mu[order].astype("<f8").tobytes())
    return digest.hexdigest()[:16]


def row_hashes(runs: Runs) -> list[bytes]:
    """Return a hash of what the vehicle told in each run, by the oldest table; empty for a run without a summary."""
    told_by_vehicle = runs.columns([feature.name for feature in PAPER_TABLE.kinematic])
    whole: BoolArray = np.asarray(np.isfinite(told_by_vehicle).all(axis=1))
    rows = told_by_vehicle.astype("<f4") + np.float32(0.0)  # -0.0 becomes 0.0
    return [hashlib.sha256(row.tobytes()).digest() if told else b"" for row, told in zip(rows, whole, strict=True)]


def to_json(card: DataCard) -> str:
    """Return a card as JSON text."""
    return json.dumps(asdict(card), indent=1, ensure_ascii=False) + "\n"


def card_from_json(text: str) -> DataCard:
    """Return the card that a JSON text holds.

    Raises:
        ShelfError: It holds none.
    """
    try:
        raw = json.loads(text)
        return replace(
            DataCard(**raw),
            kind=DataKind(raw["kind"]),
            role=Role(raw["role"]),
            sections=tuple(raw["sections"]),
            made_from={str(name): str(value) for name, value in raw["made_from"].items()},
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ShelfError(f"no card of a data set: {type(error).__name__} at {error}") from error


def _chosen(lab: Laboratory, ref: str) -> DataCard:
    return chosen(data_cards(lab), ref, what="data set")


def _check_apart(data_set: DataSet, held_out: DataSet) -> None:
    """Raise HoldOutError if a data set brings along what judges."""
    judging, learned = held_out.card, data_set.card
    judged_by = {row for row in row_hashes(held_out.runs) if row}
    shared: BoolArray = np.array([row in judged_by for row in row_hashes(data_set.runs)], dtype=np.bool_)
    if shared.any():
        places = np.flatnonzero(shared).tolist()
        keys = [data_set.runs.run_key[i] for i in places[:_NAMED_COUNT]]
        more = f" and {len(places) - len(keys)} more" if len(places) > len(keys) else ""
        raise HoldOutError(
            f"{len(places)} of the {len(data_set.runs)} rows of {learned.name} ({learned.digest}) lie in the hold-out "
            f"{judging.name} ({judging.digest}, {judging.role}): {', '.join(keys)}{more}"
        )
    roads = sorted(set(learned.sections) & set(judging.sections))
    if judging.role is Role.UNSEEN_ROADS and roads:
        raise HoldOutError(
            f"{learned.name} ({learned.digest}) has driven {len(roads)} of the roads that {judging.name} "
            f"({judging.digest}) keeps unseen: {', '.join(roads[:_NAMED_COUNT])}"
        )


def _check_card(card: DataCard, held: Sequence[DataCard]) -> None:
    check_name(card.name, digest=card.digest, held=held)
    check_words(origin=card.origin, licence=card.licence, label_kind=card.label_kind)
    if card.role is Role.MEASURED and card.kind is not DataKind.MEASURED:
        raise ShelfError("the hold-out measured is for measured labels, not for simulated ones")


def _check_labels(runs: Runs, label_sd_mu: FloatArray | None) -> None:
    usable = runs.usable
    if not usable.any():
        raise ShelfError(f"none of the {len(runs)} rows has a summary and a label")
    label_mu = runs.labels["label_mu"][usable]
    if not ((label_mu > 0.0) & (label_mu <= LABEL_LIMIT_MU)).all():
        raise ShelfError(
            f"labels from {label_mu.min():g} to {label_mu.max():g} are no frictions, above 0 and at most "
            f"{LABEL_LIMIT_MU:g}"
        )
    if label_sd_mu is not None:
        of_usable = label_sd_mu[usable]
        if not (np.isfinite(of_usable).all() and (of_usable >= 0.0).all()):
            raise ShelfError("the uncertainty of a label is not a number, or negative")


def _check_size(runs: Runs, label_sd_mu: FloatArray) -> None:
    if label_sd_mu.shape != (len(runs),):
        raise ShelfError(f"{len(runs)} rows but uncertainties of labels of shape {label_sd_mu.shape}")


def _one_of(choices: type[EnumT], word: str) -> EnumT:
    try:
        return choices(word)
    except ValueError as error:
        raise ShelfError(f"{word!r:.40} is none of {', '.join(choices)}") from error


def _write(folder: Path, card: DataCard, runs: Runs, label_sd_mu: FloatArray | None) -> None:
    write_runs(runs, folder / RUNS_FILE_NAME, description={"origin": card.origin, "data_set": card.digest})
    if label_sd_mu is not None:
        np.save(folder / LABEL_SD_FILE_NAME, label_sd_mu.astype(np.float64))
    (folder / CARD_FILE_NAME).write_text(to_json(card), encoding="utf-8")


def _read_card(folder: Path) -> DataCard:
    try:
        card = card_from_json((folder / CARD_FILE_NAME).read_text(encoding="utf-8"))
    except (ShelfError, OSError, UnicodeDecodeError) as error:
        raise ShelfError(f"{folder / CARD_FILE_NAME}: {error}") from error
    if card.digest != folder.name:
        raise ShelfError(f"{folder / CARD_FILE_NAME} is the card of {card.digest}")
    return card
