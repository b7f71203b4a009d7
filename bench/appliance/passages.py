"""Passages that no unit has seen before, as the bytes that a vehicle or another machine sends.

They are the drives behind the packaged bundle's golden vectors, all of which count, moved to the sections of
`bench.appliance.sections`. Each is made another by scaling its signals by up to 2 %, which leaves every law between
statistics whole.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.appliance.sections import served_sections
from roadgrip.bundle import BundleManifest
from roadgrip.bundle_json import manifest_from_json
from roadgrip.features import NEWEST_TABLE, STATISTICS
from roadgrip.frames import exchange_id_of, section_key_of, split_into_frames
from roadgrip.protocol import Kind
from roadgrip.records import PASSAGE_ID_BYTES, KinematicSummary, Passage
from roadgrip.section import RoadSection
from roadgrip.wire import encode_message

DEFAULT_BUNDLE = Path(str(files("rsu_app") / "default_bundle"))
SHAPES_COUNT = 2
"""Skewness and kurtosis, the last two statistics of a signal, do not change when it is scaled."""
SPREAD_RATIO = 0.02
ANY_ID = bytes(range(1, PASSAGE_ID_BYTES + 1))
TAG_BYTES = 4
"""A passage id is four bytes of the batch, four of the place in it, eight more of chance."""


@dataclass(frozen=True)
class Drive:
    """One drive over one section, of which passages are made by variation.

    Attributes:
        section: Where.
        passage: As it was, with `ANY_ID`.
    """

    section: RoadSection
    passage: Passage

    @cached_property
    def message(self) -> bytes:
        """The encoded SUMMARY."""
        return encode_message(self.passage)

    @cached_property
    def values_at(self) -> int:
        """Where in the message the statistics begin."""
        return _only_place(self.message, np.asarray(self.passage.summary.values, dtype="<f4").tobytes())

    @cached_property
    def id_at(self) -> int:
        """Where in the message the passage id begins."""
        return _only_place(self.message, self.passage.passage_id)

    @cached_property
    def json_ends(self) -> tuple[bytes, bytes]:
        """The JSON of the passage without its id, before and after the statistics."""
        passage, values_stand_in = self.passage, ["values"]
        text = json.dumps(
            {
                "map_version": passage.map_version,
                "table_digest": passage.summary.table_digest,
                "values": values_stand_in,
                "duration_s": passage.summary.duration_s,
                "quality": int(passage.summary.quality),
                "age_s": passage.age_s,
            },
            separators=(",", ":"),
        ).encode()
        before, _, after = text.partition(b'"values"]')
        return before, b"]" + after


@dataclass(frozen=True)
class Batch:
    """Passages that are all different, in the order in which they are sent.

    Attributes:
        drives: What they vary.
        drive_of: Which drive each varies. (n,)
        ids: Their ids. (n, 16)
        values: Their statistics. (n, columns)
    """

    drives: Sequence[Drive]
    drive_of: NDArray[np.intp]
    ids: NDArray[np.uint8]
    values: NDArray[np.float32]

    @property
    def tag(self) -> bytes:
        """What the ids begin with."""
        return self.ids[0, :TAG_BYTES].tobytes()

    def __len__(self) -> int:
        return len(self.ids)

    def messages(self) -> Iterator[tuple[Drive, bytes, bytes]]:
        """Yield each passage's drive, id and encoded message."""
        for place, values, drive_at in zip(self.ids, self.values.astype("<f4"), self.drive_of.tolist(), strict=True):
            drive, passage_id, packed = self.drives[drive_at], place.tobytes(), values.tobytes()
            message = bytearray(drive.message)
            message[drive.id_at : drive.id_at + PASSAGE_ID_BYTES] = passage_id
            message[drive.values_at : drive.values_at + len(packed)] = packed
            yield drive, passage_id, bytes(message)

    def frames(self) -> list[bytes]:
        """Return each passage as the one frame that it takes."""
        return [frame_of(drive, passage_id, message) for drive, passage_id, message in self.messages()]

    def json_bodies(self) -> Iterator[tuple[str, bytes]]:
        """Yield each passage's section and JSON, numbers no longer than 32 bits need."""
        row_format = ",".join(["%.9g"] * self.values.shape[1])
        for place, values, drive_at in zip(self.ids, self.values.tolist(), self.drive_of.tolist(), strict=True):
            drive = self.drives[drive_at]
            before, after = drive.json_ends
            head = f'{{"passage_id":"{place.tobytes().hex()}",'.encode() + before[1:]
            yield drive.section.section_id, head + (row_format % tuple(values)).encode() + after


def frame_of(drive: Drive, passage_id: bytes, message: bytes) -> bytes:
    """Return the frame that carries the message of a passage."""
    (frame,) = split_into_frames(
        Kind.SUMMARY,
        message,
        exchange_id=exchange_id_of(passage_id),
        section_key=section_key_of(drive.section.section_id),
    )
    return frame


def default_manifest() -> BundleManifest:
    """Return what the packaged bundle says about itself."""
    return manifest_from_json((DEFAULT_BUNDLE / "manifest.json").read_text(encoding="utf-8"))


@lru_cache(maxsize=1)
def golden_drives() -> tuple[Drive, ...]:
    """Return the drives of the packaged bundle's golden vectors on each section that is served."""
    (model,) = (model for model in default_manifest().models if model.table_digest == NEWEST_TABLE.digest)
    speed_at, columns_count = NEWEST_TABLE.index("speed_mean_mps"), len(NEWEST_TABLE.kinematic)
    drives = []
    for section in served_sections():
        for row in model.golden.rows:
            values = np.asarray(row[:columns_count], dtype=np.float32)
            duration_s = round(section.length_m / float(values[speed_at]), 2)
            summary = KinematicSummary(tuple(values.tolist()), NEWEST_TABLE.digest, duration_s)
            passage = Passage(ANY_ID, section.section_id, section.version, summary, age_s=2.35)
            drives.append(Drive(section, passage))
    return tuple(drives)


def draw_batch(passages_count: int, *, rng: np.random.Generator) -> Batch:
    """Return passages that are different from each other and from those of every other batch.

    Args:
        passages_count: How many.
        rng: Draws ids, drives and what is different.
    """
    drives, speed_at = golden_drives(), NEWEST_TABLE.index("speed_mean_mps")  # which duration and length must go with
    drive_of = rng.integers(len(drives), size=passages_count)
    ids = rng.integers(256, size=(passages_count, PASSAGE_ID_BYTES), dtype=np.uint8)
    ids[:, :TAG_BYTES] = rng.integers(256, size=TAG_BYTES, dtype=np.uint8)
    ids[:, TAG_BYTES : 2 * TAG_BYTES] = np.arange(passages_count, dtype=">u4").view(np.uint8).reshape(-1, 4)
    values = np.array([drive.passage.summary.values for drive in drives], dtype=np.float32)[drive_of]
    for columns in NEWEST_TABLE.statistics_columns[:, : len(STATISTICS) - SHAPES_COUNT]:
        if speed_at not in columns:
            ratio = rng.uniform(1.0 - SPREAD_RATIO, 1.0 + SPREAD_RATIO, (passages_count, 1))
            values[:, columns] *= ratio.astype(np.float32)
    return Batch(drives, drive_of, ids, values)


def _only_place(message: bytes, part: bytes) -> int:
    if message.count(part) != 1:
        raise RuntimeError("a message does not hold what shall be changed exactly once")
    return message.index(part)
