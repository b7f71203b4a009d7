"""Summaries as a unit judges them: its own plausibility, models, envelope and bounds, for many at once."""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import pairwise
from math import nan

import numpy as np

from roadgrip.features import TABLES, FeatureTable, road_features
from roadgrip.records import KinematicSummary, NotCounted, Passage
from roadgrip.section import RoadSection
from roadgrip.units import BoolArray, FloatArray
from rsu_app.domain.judgement import judgements
from rsu_app.domain.plausibility import implausibilities
from rsu_app.ports import FrictionModel


@dataclass(frozen=True, slots=True)
class Judged:
    """What passages say to a unit, those that count.

    Attributes:
        values: What was sent; columns as in the table's kinematic features. (n, k)
        mu: The estimates. (n,)
        expected_error_ratio: Of each. (n,)
        mu_low: Below this the friction hardly is. (n,)
        at_least: Which only say "at least `mu_low`". (n,)
        profile_ratio: Log likelihood of each friction of the grid; NaN where the table has none. (n, 12)
        slowest_mps: How slowly each drove where it was slowest. (n,)
    """

    values: FloatArray
    mu: FloatArray
    expected_error_ratio: FloatArray
    mu_low: FloatArray
    at_least: BoolArray
    profile_ratio: FloatArray
    slowest_mps: FloatArray

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.mu)

    @property
    def heard_mu(self) -> FloatArray:
        """What each is taken for: its estimate, or its bound where it says no more. (n,)"""
        return np.where(self.at_least, self.mu_low, self.mu)

    def rows(self, chosen: np.ndarray) -> Judged:
        """Return some of them, maybe more than once; by numbers or by a mask."""
        return Judged(*(getattr(self, field.name)[chosen] for field in fields(self)))


@dataclass(frozen=True, slots=True)
class Door:
    """What stands between a sender and the window of one section.

    Attributes:
        section: The map.
        table: The feature table of the summaries.
        model: The unit's live models.
    """

    section: RoadSection
    table: FeatureTable
    model: FrictionModel

    def judge(self, values: FloatArray) -> tuple[BoolArray, Judged]:
        """Return which summaries count, and what all of them say (nonsense where they do not count).

        The liar claims the duration that fits his speed, and an age of two seconds.

        Args:
            values: As sent. (n, k)
        """
        sent = values.astype(np.float32).astype(np.float64)
        if not len(sent):
            return np.zeros(0, dtype=np.bool_), _nothing(sent, self.table)
        speed_mps = sent[:, self.table.index("speed_mean_mps")]
        duration_s = self.section.length_m / np.maximum(speed_mps, 0.1)
        passages = [
            Passage(
                passage_id=bytes(16),
                section_id=self.section.section_id,
                map_version=self.section.version,
                summary=KinematicSummary(tuple(row), self.table.digest, float(lasted_s)),
                age_s=2.0,
            )
            for row, lasted_s in zip(sent.tolist(), duration_s.tolist(), strict=True)
        ]
        refused = implausibilities(passages, sent.astype(np.float32), [self.section] * len(passages))
        possible = np.array([each is None for each in refused], dtype=np.bool_)
        said = _nothing(sent, self.table)
        counted = np.zeros(len(sent), dtype=np.bool_)
        if not possible.any():
            return counted, said
        manifest = self.model.manifest.model_for(self.table.digest, section_id=self.section.section_id)
        assert manifest is not None  # noqa: S101 - the default bundle serves both tables
        road = road_features(self.section, self.table)
        rows = np.column_stack([sent[possible], np.tile(road, (int(possible.sum()), 1))])
        answer = self.model.estimate(self.table.digest, rows, section_id=self.section.section_id)
        errors = answer.expected_error_ratio
        found = judgements(
            rows,
            manifest,
            mu=answer.mu.tolist(),
            expected_error_ratio=None if errors is None else errors.tolist(),
        )
        counted[possible] = [each.flags == NotCounted.NONE and each.mu is not None for each in found]
        said.mu[possible] = [nan if each.mu is None else each.mu for each in found]
        said.expected_error_ratio[possible] = [
            nan if each.expected_error_ratio is None else each.expected_error_ratio for each in found
        ]
        said.mu_low[possible] = [nan if each.mu_low is None else each.mu_low for each in found]
        said.at_least[possible] = [each.at_least for each in found]
        return counted, said

    def counted(self, values: FloatArray) -> Judged:
        """Return what those say that count."""
        counts, said = self.judge(values)
        return said.rows(counts)


def _nothing(values: FloatArray, table: FeatureTable) -> Judged:
    count = len(values)
    places = [place for place, name in enumerate(table.names) if name.startswith("grip_profile_")]
    return Judged(
        values=values,
        mu=np.full(count, nan),
        expected_error_ratio=np.full(count, nan),
        mu_low=np.full(count, nan),
        at_least=np.zeros(count, dtype=np.bool_),
        profile_ratio=values[:, places] if places else np.full((count, _PROFILE_COUNT), nan),
        slowest_mps=values[:, table.index("speed_min_mps")],
    )


def joined(parts: list[Judged]) -> Judged:
    """Return all of them; `values` of another table are cut to the shortest."""
    width = min(part.values.shape[1] for part in parts)
    rest = [field.name for field in fields(Judged) if field.name != "values"]
    return Judged(
        np.concatenate([part.values[:, :width] for part in parts]),
        *(np.concatenate([getattr(part, name) for part in parts]) for name in rest),
    )


def distinct(judged: Judged) -> Judged:
    """Return each summary once: the same values under another id are refused as replayed."""
    order = np.lexsort(judged.values.T[::-1])
    same = [bool((judged.values[a] == judged.values[b]).all()) for a, b in pairwise(order.tolist())]
    return judged.rows(np.sort(order[~np.array([False, *same], dtype=np.bool_)]))


_PROFILE_COUNT = max(sum(1 for name in table.names if name.startswith("grip_profile_")) for table in TABLES.values())
