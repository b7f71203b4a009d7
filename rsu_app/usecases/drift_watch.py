"""The unit's eye on drift: what the newest passages of a section say about its live model."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Sequence
from functools import partial
from typing import Protocol

import numpy as np

from roadgrip.bundle import BundleManifest
from roadgrip.features import TABLES
from roadgrip.records import NotCounted
from rsu_app.domain.drift import DriftPolicy, DriftReport, drift_report
from rsu_app.domain.feature_window import FeatureWindow
from rsu_app.domain.section_baseline import SectionBaseline
from rsu_app.ports import CountablePassage

DRIFT_WINDOW_S = 6.0 * 3_600.0
"""Passages that are looked at: longer than they count, for most sections see too few in an hour to tell."""
LEARNED_FROM_COUNT = 4_000
"""Stored passages that a section's earlier traffic is learned from again after a restart, the first ones."""
MEANWHILE_COUNT = 256
"""Passages that are kept until the earlier ones are known; a unit looks at a section every minute."""


class LoadFirst(Protocol):
    """Reads the first stored passages of a section that a bundle judged, in their order."""

    def __call__(self, *, bundle_id: str) -> Awaitable[Sequence[CountablePassage]]:
        """Return them."""
        ...


class DriftWatch:
    """Looks at one section under one bundle.

    Args:
        section_id: The section.
        policy: From where on something has drifted.
    """

    def __init__(self, section_id: str, *, policy: DriftPolicy | None = None) -> None:
        self._section_id = section_id
        self._policy = policy or DriftPolicy()
        self._window = FeatureWindow(window_s=DRIFT_WINDOW_S)
        self._baselines: dict[str, SectionBaseline] = {}
        self._bundle_id = ""
        self._news = False
        self._earlier_known = False
        self._meanwhile: list[CountablePassage] = []
        self.latest: DriftReport | None = None

    @property
    def has_news(self) -> bool:
        """Whether a passage came since the last look."""
        return self._news

    def note(self, passage: CountablePassage, *, left_at_s: float) -> None:
        """Remember a passage that was stored just now; one that another bundle judged is of no use.

        Args:
            passage: What the store holds.
            left_at_s: When the vehicle left the section, by the monotonic clock.
        """
        estimate = passage.estimate
        if estimate.bundle_id != self._bundle_id or passage.table_digest not in TABLES:
            return
        if estimate.flags is NotCounted.NONE or NotCounted.OUT_OF_ENVELOPE in estimate.flags:
            self._window.add(
                left_at_s=left_at_s,
                table_digest=passage.table_digest,
                values=passage.values,
                mu=estimate.mu,
                flags=estimate.flags,
            )
            self._news = True

    def learn(self, passage: CountablePassage) -> None:
        """Let a passage that counts be part of the section's earlier traffic, if there is room for it.

        To be called with every passage once, in the order in which they are stored. Before `learn_earlier` nothing is
        learned: what is stored by then comes from there.
        """
        if self._earlier_known:
            self._learn(passage)
        else:
            self._meanwhile.append(passage)
            del self._meanwhile[:-MEANWHILE_COUNT]

    async def learn_earlier(self, load: LoadFirst) -> None:
        """Learn what the section's traffic was like under this bundle so far, unless that is known.

        Not part of a start: a unit is ready before it has read thousands of passages, and in a data centre most
        sections see none for hours.

        Args:
            load: Reads the section's.

        Raises:
            StoreError: The store cannot be read; nothing was learned.
        """
        if self._earlier_known:
            return
        bundle_id = self._bundle_id
        earlier = await load(bundle_id=bundle_id)
        if bundle_id != self._bundle_id or self._earlier_known:
            return  # another bundle is live by now
        known_ids = {passage.estimate.passage_id for passage in earlier}
        # Who was stored while the store was read is in neither, or in both.
        later = [passage for passage in self._meanwhile if passage.estimate.passage_id not in known_ids]
        self._earlier_known, self._meanwhile = True, []
        for passage in (*earlier, *later):
            self._learn(passage)

    def _learn(self, passage: CountablePassage) -> None:
        estimate, digest = passage.estimate, passage.table_digest
        counts = estimate.flags is NotCounted.NONE and estimate.mu is not None and estimate.mu > 0.0
        if counts and estimate.bundle_id == self._bundle_id and digest in TABLES:
            baseline = self._baselines.setdefault(digest, SectionBaseline())
            # Hours are told apart by the wall clock, which means the same after a restart.
            baseline.add(left_at_s=estimate.left_unix_s, values=passage.values, mu=estimate.mu or 0.0)

    def begin(self, bundle_id: str) -> None:
        """Start over under another bundle: its estimates, flags and first traffic are others'."""
        if bundle_id != self._bundle_id:
            self._bundle_id = bundle_id
            self._window.forget()
            self._baselines.clear()
            self._earlier_known, self._meanwhile = False, []
            self.latest, self._news = None, False

    async def look(self, manifest: BundleManifest, *, now_s: float) -> DriftReport | None:
        """Return what the passages say, by the feature table that most of them speak; None without a passage.

        Takes some 20 ms of another thread, and nothing when no passage came since the last look.

        Args:
            manifest: Of the live bundle.
            now_s: By the monotonic clock.
        """
        if not self._news:
            return self.latest
        self._news = False
        tables = [(digest, self._window.rows(digest, now_s=now_s)) for digest in self._window.table_digests]
        held = [(digest, rows) for digest, rows in tables if rows is not None]
        if not held:
            self.latest = None
            return None
        digest, rows = max(held, key=lambda each: len(each[1].values))
        model, baseline = manifest.model_for(digest, section_id=self._section_id), self._baselines.get(digest)
        bundle_id = self._bundle_id
        report = await asyncio.to_thread(
            partial(
                drift_report,
                None if model is None else model.reference_for(self._section_id),
                [feature.name for feature in TABLES[digest].kinematic],
                rows.values.astype(np.float64),
                rows.mu,
                out_of_envelope_count=rows.out_of_envelope_count,
                total_count=len(rows.values),
                baseline=() if baseline is None else baseline.bands,
                policy=self._policy,
            )
        )
        if bundle_id == self._bundle_id:  # no switch came in between
            self.latest = report
        return self.latest
