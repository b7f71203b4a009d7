"""Ground truth of a laboratory: tables of measurements, named by their content, described and never changed.

lab/data/ground-truth/<digest>/
  measurements.csv   in canonical form, whatever the trailer's software wrote
  refused.csv        rows of the original that are not used, each with its reason
  card.json          what it is, where it comes from, who may use it
"""

from __future__ import annotations

import hashlib
import json
import time
from dataclasses import asdict, dataclass, replace
from math import inf
from pathlib import Path

from training.data.ground_truth import (
    GroundTruth,
    GroundTruthError,
    Measurement,
    canonical_csv,
    ground_truth_digest,
    read_ground_truth,
    refused_csv,
)
from training.data.shelf import (
    CARD_FILE_NAME,
    ShelfError,
    check_name,
    check_words,
    chosen,
    digests_in,
    put_on_shelf,
)
from training.laboratory import Laboratory

FOLDER_NAME = "ground-truth"
MEASUREMENTS_FILE_NAME = "measurements.csv"
REFUSED_FILE_NAME = "refused.csv"


@dataclass(frozen=True, slots=True)
class GroundTruthCard:
    """What a table of measurements says of itself.

    Attributes:
        name: What people call it; no two on a shelf are called the same.
        digest: Sixteen hexadecimal characters that name its measurements.
        origin: Who measured, for a person.
        licence: Who may do what with it.
        measurements_count: Rows that are used.
        refused_count: Rows that are not.
        sections: Where was measured, in order.
        instruments: With what, in order.
        from_unix_s: Begin of the first span.
        until_unix_s: End of the last one.
        source_sha256: Of the file it was read from.
        added_unix_s: When it was put on the shelf.
    """

    name: str
    digest: str
    origin: str
    licence: str
    measurements_count: int
    refused_count: int
    sections: tuple[str, ...]
    instruments: tuple[str, ...]
    from_unix_s: float
    until_unix_s: float
    source_sha256: str
    added_unix_s: float


@dataclass(frozen=True, slots=True)
class GroundTruthSet:
    """A table of measurements as it lies on the shelf.

    Attributes:
        card: What it says of itself.
        measurements: By section and time.
    """

    card: GroundTruthCard
    measurements: tuple[Measurement, ...]


def add_ground_truth(
    lab: Laboratory,
    truth: GroundTruth,
    *,
    name: str,
    origin: str,
    licence: str,
    source: bytes,
    now_unix_s: float | None = None,
) -> GroundTruthCard:
    """Return the card of measurements that were put on the shelf; the same ones again give the card they have.

    Args:
        lab: Whose shelf.
        truth: What was read.
        name: What people shall call it.
        origin: Who measured.
        licence: Who may do what with it.
        source: The file it was read from.
        now_unix_s: When; now by default.

    Raises:
        ShelfError: There is no measurement, something is missing, or another table has the name.
    """
    measurements = truth.measurements
    if not measurements:
        raise ShelfError(f"all {len(truth.refused)} rows were refused: there is nothing to put on the shelf")
    card = GroundTruthCard(
        name=name,
        digest=ground_truth_digest(measurements),
        origin=origin,
        licence=licence,
        measurements_count=len(measurements),
        refused_count=len(truth.refused),
        sections=tuple(sorted({each.section_id for each in measurements})),
        instruments=tuple(sorted({each.instrument for each in measurements})),
        from_unix_s=min(each.from_unix_s for each in measurements),
        until_unix_s=max(each.until_unix_s for each in measurements),
        source_sha256=hashlib.sha256(source).hexdigest(),
        added_unix_s=time.time() if now_unix_s is None else now_unix_s,
    )
    held = ground_truth_cards(lab)
    for other in held:
        if other.digest == card.digest:
            return other
    check_name(card.name, digest=card.digest, held=held)
    check_words(origin=card.origin, licence=card.licence)
    put_on_shelf(_folder(lab) / card.digest, lambda folder: _write(folder, card, truth))
    return card


def read_ground_truth_set(lab: Laboratory, ref: str) -> GroundTruthSet:
    """Return a table of the shelf whose measurements still are what its digest names.

    Args:
        lab: Whose shelf.
        ref: Digest, name, or beginning of a digest.

    Raises:
        ShelfError: It is not there, or has changed.
    """
    card = chosen(ground_truth_cards(lab), ref, what="ground truth")
    path = _folder(lab) / card.digest / MEASUREMENTS_FILE_NAME
    try:
        # Whether a span lay in the future was asked when it was put there.
        truth = read_ground_truth(path.read_text(encoding="utf-8"), now_unix_s=inf)
    except (GroundTruthError, OSError, UnicodeDecodeError) as error:
        raise ShelfError(f"ground truth {card.name} ({card.digest}) cannot be read: {error}") from error
    found = ground_truth_digest(truth.measurements)
    if truth.refused or found != card.digest:
        raise ShelfError(
            f"ground truth {card.name} ({card.digest}) has changed since it was put on the shelf: its content is "
            f"{found}, with {len(truth.refused)} rows that cannot be read; nothing may rest on it"
        )
    return GroundTruthSet(card, truth.measurements)


def ground_truth_cards(lab: Laboratory) -> list[GroundTruthCard]:
    """Return the cards of all tables of measurements on the shelf, oldest first.

    Raises:
        ShelfError: A card cannot be read.
    """
    cards = [_read_card(_folder(lab) / digest) for digest in digests_in(_folder(lab))]
    return sorted(cards, key=lambda card: (card.added_unix_s, card.digest))


def _folder(lab: Laboratory) -> Path:
    return lab.data_folder / FOLDER_NAME


def _write(folder: Path, card: GroundTruthCard, truth: GroundTruth) -> None:
    (folder / MEASUREMENTS_FILE_NAME).write_text(canonical_csv(truth.measurements), encoding="utf-8")
    (folder / REFUSED_FILE_NAME).write_text(refused_csv(truth.refused), encoding="utf-8", errors="backslashreplace")
    text = json.dumps(asdict(card), indent=1, ensure_ascii=False) + "\n"
    (folder / CARD_FILE_NAME).write_text(text, encoding="utf-8")


def _read_card(folder: Path) -> GroundTruthCard:
    path = folder / CARD_FILE_NAME
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
        card = GroundTruthCard(**raw)
        card = replace(card, sections=tuple(card.sections), instruments=tuple(card.instruments))
    except (OSError, TypeError, ValueError) as error:
        raise ShelfError(f"{path} is no card of ground truth: {error}") from error
    if card.digest != folder.name:
        raise ShelfError(f"{path} is the card of {card.digest}")
    return card
