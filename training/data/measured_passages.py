"""Exported passages and what trailers measured on the same roads at the same time, joined to rows to learn from.

A passage gets the friction of the measurement in whose span it left the section. Spans may be widened by some minutes,
for a road is mostly the same a little earlier and later; a passage inside an unwidened span never looks beyond it.

A trailer measures with a new reference tyre, a car's tyres are worn: it finds 0.8 to 1 of what a new tyre finds, nobody
knows which. Its label therefore is the measured friction times the middle of that range, and as uncertain as wear is.

References:
    Langstrand and Rabi, Learning to cooperatively estimate road surface friction: the interval [0.8 mu_new, mu_new].
"""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from math import sqrt

import numpy as np

from roadgrip.errors import SectionError
from roadgrip.features import TABLES, FeatureTable, road_features
from roadgrip.passage_export import ExportedPassage
from roadgrip.records import KinematicSummary, Passage, QualityFlag
from roadgrip.section import RoadSection
from roadgrip.section_file import section_from_json
from roadgrip.units import FloatArray
from rsu_app.domain.plausibility import implausibility
from training.data.exported_passages import Export, PassageReason, RefusedPassage
from training.data.ground_truth import Measurement
from training.dataset import COMPLETED, LABEL_COLUMNS, Runs, joined

DEFAULT_SLACK_S = 600.0
DEFAULT_WEAR_RATIO = 0.9
"""Middle of what worn to new tyres find of a new tyre's friction, 0.8 to 1."""
WEAR_SD_RATIO = 0.2 / sqrt(12.0)
"""Standard deviation of wear that is even between 0.8 and 1."""
WEAR_LIMIT_RATIO = 1.5
REFUSED_QUALITY = QualityFlag.SENSORS_DOUBTFUL | QualityFlag.REFERENCE_SPEED
"""A vehicle with a broken sensor tells of the sensor; one with a reference instrument is no vehicle of the road."""
_NO_PASSAGE_ID = bytes(16)
"""An export names no passage; the check of plausibility wants an id of the right length."""


@dataclass(frozen=True, slots=True)
class Joined:
    """Passages with a measured friction.

    Attributes:
        runs_by_table: Rows by the digest of their feature table; tables without rows are left out.
        label_sd_mu: Standard deviation of each row's label, by the same digests. Each (n,)
        refused: What is no row, in the order of the files and lines.
    """

    runs_by_table: Mapping[str, Runs]
    label_sd_mu: Mapping[str, FloatArray]
    refused: tuple[RefusedPassage, ...]

    @property
    def rows_count(self) -> int:
        """Rows of all tables."""
        return sum(len(runs) for runs in self.runs_by_table.values())

    @property
    def refused_count(self) -> Mapping[PassageReason, int]:
        """How many passages were refused, by reason, most frequent first."""
        return dict(Counter(each.reason for each in self.refused).most_common())


@dataclass(frozen=True, slots=True)
class _Row:
    table: FeatureTable
    features: FloatArray
    labels: Mapping[str, float]
    label_sd_mu: float
    scenario: str
    section_id: str
    run_key: str


class _Refusal(Exception):  # noqa: N818 - it never leaves this module, where it becomes a value
    def __init__(self, reason: PassageReason, message: str) -> None:
        super().__init__(message)
        self.reason = reason


def measured_runs(
    exports: Sequence[Export],
    measurements: Sequence[Measurement],
    *,
    slack_s: float = DEFAULT_SLACK_S,
    wear_ratio: float = DEFAULT_WEAR_RATIO,
    table: FeatureTable | None = None,
    refused_quality: QualityFlag = REFUSED_QUALITY,
    sections: Sequence[RoadSection] = (),
) -> Joined:
    """Return the passages of some exports that a measurement speaks for, as rows with its friction.

    The rows come by their keys, which are hashes of what the vehicle told: neither the order nor a name tells when
    somebody drove. A passage that two exports hold is one row.

    Args:
        exports: What units gave.
        measurements: What trailers found.
        slack_s: By so much a span is widened at both ends, for passages that lie in no span as it is.
        wear_ratio: What a car is expected to find of what the trailer's tyre found.
        table: Whose columns the rows shall have; passages of older tables are refused then. None: each of its own.
        refused_quality: Passages whose vehicle says one of these of itself are refused.
        sections: Maps that were driven by and that none of the exports holds.

    Raises:
        ValueError: An option is none.
    """
    if not slack_s >= 0.0 or not 0.0 < wear_ratio <= WEAR_LIMIT_RATIO:
        raise ValueError(f"a slack of {slack_s} s or a wear ratio of {wear_ratio} is none")
    rule = _Rule(_Book(measurements, slack_s=slack_s), wear_ratio, table, refused_quality)
    maps = _Maps(exports, {section.version: section for section in sections})
    rows: dict[str, _Row] = {}
    refused: list[RefusedPassage] = []
    for export in exports:
        refused += export.refused
        for number, passage in export.passages.items():
            try:
                row = rule.row_of(passage, maps)
            except _Refusal as refusal:
                refused.append(RefusedPassage(export.name, number, refusal.reason, str(refusal)))
                continue
            if row.run_key in rows:
                told = "two exports hold it, or one holds it twice"
                refused.append(RefusedPassage(export.name, number, PassageReason.REPEATED, told))
            rows.setdefault(row.run_key, row)
    return _joined(rows, table, tuple(refused))


def label_of(measurement: Measurement, *, wear_ratio: float = DEFAULT_WEAR_RATIO) -> tuple[float, float]:
    """Return what a car is expected to have found where a trailer measured, and its standard deviation.

    The deviation is that of a product of independent factors, the measured friction and the wear.

    Args:
        measurement: What the trailer found.
        wear_ratio: What a car is expected to find of it.
    """
    mu, mu_sd = measurement.mu, measurement.mu_sd
    deviations = (wear_ratio * mu_sd, mu * WEAR_SD_RATIO, mu_sd * WEAR_SD_RATIO)
    return wear_ratio * mu, sqrt(sum(each**2 for each in deviations))


@dataclass(slots=True)
class _Book:
    """Measurements by section."""

    measurements: Sequence[Measurement]
    slack_s: float
    by_section: dict[str, list[Measurement]] = field(default_factory=lambda: defaultdict(list))

    def __post_init__(self) -> None:
        for each in self.measurements:
            self.by_section[each.section_id].append(each)

    def of(self, passage: ExportedPassage) -> Measurement:
        """Return the one measurement that speaks for a passage."""
        left_unix_s, here = passage.left_unix_s, self.by_section.get(passage.section_id, [])
        found = [each for each in here if each.from_unix_s <= left_unix_s < each.until_unix_s]
        if not found:
            low_unix_s, high_unix_s = left_unix_s - self.slack_s, left_unix_s + self.slack_s
            found = [each for each in here if each.from_unix_s <= high_unix_s and low_unix_s < each.until_unix_s]
        if not found:
            raise _Refusal(PassageReason.NO_MEASUREMENT, f"nothing was measured on {passage.section_id} at the time")
        if len(found) > 1:
            told = " and ".join(f"{each.mu:g} by {each.instrument}" for each in found)
            raise _Refusal(PassageReason.SEVERAL_MEASUREMENTS, f"measured more than once at the time: {told}"[:300])
        return found[0]


@dataclass(frozen=True, slots=True)
class _Rule:
    """How a passage becomes a row."""

    book: _Book
    wear_ratio: float
    table: FeatureTable | None
    refused_quality: QualityFlag

    def row_of(self, passage: ExportedPassage, maps: _Maps) -> _Row:
        """Return the row of a passage, or raise why it is none."""
        _check_quality(passage, self.refused_quality)
        measurement = self.book.of(passage)
        section = maps.of(passage)
        _check_plausible(passage, section)
        own = TABLES[passage.table_digest]
        if self.table is not None and not own.covers(self.table):
            told = f"feature table {own.version} lacks columns of table {self.table.version}"
            raise _Refusal(PassageReason.OLDER_TABLE, told)
        road = maps.road_features(section, own)
        return _row(passage, section, measurement, road, wear_ratio=self.wear_ratio)


@dataclass(slots=True)
class _Maps:
    """The maps that passages were driven by, read when first asked for.

    A unit exports the maps it serves now; after a new survey an export of before still holds the older one.
    """

    exports: Sequence[Export]
    read: dict[str, RoadSection | str]
    road_rows: dict[tuple[str, str], FloatArray] = field(default_factory=dict)

    def of(self, passage: ExportedPassage) -> RoadSection:
        """Return the map by which a passage was driven."""
        version = passage.map_version
        if version not in self.read:
            self.read[version] = self._section_or_problem(version)
        section = self.read[version]
        if isinstance(section, str):
            raise _Refusal(PassageReason.NO_MAP, section)
        if section.section_id != passage.section_id:
            told = f"map {version[:64]} is of {section.section_id}, the passage of {passage.section_id[:64]}"
            raise _Refusal(PassageReason.NO_MAP, told)
        return section

    def road_features(self, section: RoadSection, table: FeatureTable) -> FloatArray:
        """Return the features that follow from a map; computed once."""
        name = (section.version, table.digest)
        if name not in self.road_rows:
            self.road_rows[name] = road_features(section, table)
        return self.road_rows[name]

    def _section_or_problem(self, version: str) -> RoadSection | str:
        """Return the map of a version from whichever export holds it, or what is wrong with it."""
        problem = f"no export holds map {version[:64]}"
        for export in self.exports:
            text = export.head.sections_json.get(version)
            if text is None:
                continue
            try:
                section = section_from_json(text)
            except SectionError as error:
                problem = f"map {version[:64]} cannot be used: {error}"
                continue
            if section.version == version:
                return section
            problem = f"map {version[:64]} is {section.version} in truth"
        return problem


def _check_quality(passage: ExportedPassage, refused_quality: QualityFlag) -> None:
    said = QualityFlag(passage.quality & refused_quality.value)
    if said:
        words = ", ".join(flag.name.lower() for flag in said if flag.name)
        raise _Refusal(PassageReason.QUALITY, f"the vehicle says of itself: {words}")


def _check_plausible(passage: ExportedPassage, section: RoadSection) -> None:
    """Refuse what a unit would refuse: a file is a door like the air."""
    summary = KinematicSummary(tuple(passage.values.tolist()), passage.table_digest, passage.duration_s)
    claimed = Passage(_NO_PASSAGE_ID, passage.section_id, passage.map_version, summary, age_s=0.0)
    problem = implausibility(claimed, section)
    if problem is not None:
        raise _Refusal(PassageReason(problem.reason.value), problem.detail)


def _row(
    passage: ExportedPassage,
    section: RoadSection,
    measurement: Measurement,
    road: FloatArray,
    *,
    wear_ratio: float,
) -> _Row:
    table = TABLES[passage.table_digest]
    label_mu, label_sd_mu = label_of(measurement, wear_ratio=wear_ratio)
    labels = dict.fromkeys(LABEL_COLUMNS, np.nan) | {
        "label_mu": label_mu,
        "base_friction_mu": measurement.mu,
        "rated_speed_mps": section.speed_limit_mps,
        "mean_speed_mps": float(passage.values[table.index("speed_mean_mps")]),
        "duration_s": passage.duration_s,
    }
    told = hashlib.sha256(f"{passage.section_id}|{passage.map_version}|{passage.table_digest}|".encode())
    told.update(passage.values.astype("<f4").tobytes())
    return _Row(
        table=table,
        features=np.concatenate([passage.values.astype(np.float64), road]),
        labels=labels,
        label_sd_mu=label_sd_mu,
        scenario=f"{passage.section_id}@{datetime.fromtimestamp(measurement.from_unix_s, UTC):%Y%m%dT%H%MZ}",
        section_id=passage.section_id,
        run_key=f"measured/{passage.section_id}/{told.hexdigest()[:16]}",
    )


def _joined(rows: Mapping[str, _Row], table: FeatureTable | None, refused: tuple[RefusedPassage, ...]) -> Joined:
    by_table: dict[str, list[_Row]] = defaultdict(list)
    for key in sorted(rows):
        by_table[rows[key].table.digest].append(rows[key])
    runs = {digest: _runs(of_table, TABLES[digest]) for digest, of_table in by_table.items()}
    label_sd_mu = {digest: np.array([row.label_sd_mu for row in of_table]) for digest, of_table in by_table.items()}
    if table is not None and runs:
        runs = {table.digest: joined([part.for_table(table) for part in runs.values()])}
        label_sd_mu = {table.digest: np.concatenate(list(label_sd_mu.values()))}
    return Joined(runs, label_sd_mu, refused)


def _runs(rows: Sequence[_Row], table: FeatureTable) -> Runs:
    return Runs(
        features=np.array([row.features for row in rows]),
        labels={name: np.array([row.labels[name] for row in rows]) for name in LABEL_COLUMNS},
        scenario=tuple(row.scenario for row in rows),
        section_id=tuple(row.section_id for row in rows),
        outcome=(COMPLETED,) * len(rows),
        run_key=tuple(row.run_key for row in rows),
        table=table,
    )
