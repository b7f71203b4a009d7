"""Fakes of the ports, real code without a disk or a clock, and the records that tests start from."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from roadgrip.bundle import BundleManifest
from roadgrip.errors import BundleError, StoreError
from roadgrip.features import NEWEST_TABLE, TABLES, FeatureTable, statistics_of
from roadgrip.ledger import Action, LedgerEntry, entry_after
from roadgrip.records import KinematicSummary, Passage, QualityFlag
from roadgrip.release import Release
from roadgrip.section import BankOrigin, RoadSection, build_section
from roadgrip.units import FloatArray, kph_to_mps
from rsu_app.domain.rollout import RolloutState, ShelvedBundle
from rsu_app.ports import (
    ArrivalKey,
    CountablePassage,
    Estimates,
    PassageEntry,
    StoreCounts,
    StoredEstimate,
    WriterPulse,
)
from rsu_app.rollout_ports import FetchedRelease, UpdateRefusal
from tests.bundles import BIAS_MU, CONFORMAL, ERROR_BIAS_RATIO, ERROR_WEIGHTS, linear_mu, make_manifest

NOON_UNIX_S = 1_767_268_800.0
"""2026-01-01 12:00 UTC."""


class FakeClock:
    """Two clocks that stand still until told otherwise."""

    def __init__(self, *, monotonic_s: float = 1000.0, unix_s: float = NOON_UNIX_S) -> None:
        self.now_monotonic_s = monotonic_s
        self.now_unix_s = unix_s

    def monotonic_s(self) -> float:
        return self.now_monotonic_s

    def unix_s(self) -> float:
        return self.now_unix_s

    def advance(self, seconds: float) -> None:
        self.now_monotonic_s += seconds
        self.now_unix_s += seconds


class FakeModel:
    """Answers 0.5 plus the mean sideslip, or whatever it is told to answer."""

    def __init__(self, manifest: BundleManifest | None = None) -> None:
        self._manifest = manifest or make_manifest(model=b"a fake has no file")
        self.error: Exception | None = None
        self.answer_mu: float | None = None

    @property
    def manifest(self) -> BundleManifest:
        return self._manifest

    def estimate(self, table_digest: str, rows: FloatArray, *, section_id: str | None = None) -> Estimates:
        if self.error is not None:
            raise self.error
        table = TABLES[table_digest]
        mu = linear_mu(rows, table=table) if self.answer_mu is None else np.full(len(rows), self.answer_mu)
        model = self._manifest.model_for(table_digest, section_id=section_id)
        assert model is not None
        if model.conformal is None:
            return Estimates(mu, None)
        return Estimates(mu, linear_mu(rows, weights=ERROR_WEIGHTS, bias_mu=ERROR_BIAS_RATIO, table=table))


class WaveringModel(FakeModel):
    """Expects an error that makes every estimate doubtful, once it wavers."""

    def __init__(self) -> None:
        super().__init__(make_manifest(model=b"a fake has no file", conformal=CONFORMAL))
        self.wavers = False

    def estimate(self, table_digest: str, rows: FloatArray, *, section_id: str | None = None) -> Estimates:
        answer = super().estimate(table_digest, rows, section_id=section_id)
        return replace(answer, expected_error_ratio=np.full(len(rows), 0.5)) if self.wavers else answer


class FakeStore:
    """Keeps passages in memory; survives a restart if handed to the next unit.

    `error` makes every write fail; `gate`, when set to an event, makes writes wait for it.
    """

    def __init__(self) -> None:
        self.entries: list[PassageEntry] = []
        self.ledger_entries = [
            entry_after(
                None,
                at_unix_s=NOON_UNIX_S,
                actor="unit",
                action=Action.LEDGER_BEGUN,
                subject="",
                reason="a new database",
            )
        ]
        self.error: StoreError | None = None
        self.gate: asyncio.Event | None = None
        self.closed = False
        self.pulse = WriterPulse(committed_ago_s=1.0, busy_s=0.0, queued_count=0)
        self.notes: tuple[str, ...] = ()

    async def append(self, entries: Sequence[PassageEntry]) -> list[StoredEstimate | None]:
        await self._write()
        return [self._kept(entry) for entry in entries]

    def _kept(self, entry: PassageEntry) -> StoredEstimate | None:
        same_id = [e.estimate for e in self.entries if e.estimate.passage_id == entry.estimate.passage_id]
        same_values = [e.estimate for e in self.entries if e.estimate.values_digest == entry.estimate.values_digest]
        if same_id or same_values:
            return (same_id or same_values)[0]
        self.entries.append(entry)
        return None

    async def load(
        self, *, since_unix_s: float, limit_count: int, before: ArrivalKey | None = None
    ) -> Sequence[CountablePassage]:
        arrived = [
            replace(entry.countable, arrival=(entry.received_unix_s, number))
            for number, entry in enumerate(self.entries)
            if entry.received_unix_s >= since_unix_s
        ]
        arrived.sort(key=lambda passage: passage.arrival or (0.0, 0))
        return [passage for passage in arrived if before is None or (passage.arrival or before) < before][-limit_count:]

    async def load_first(self, *, section_id: str, bundle_id: str, limit_count: int) -> Sequence[CountablePassage]:
        wanted = [e for e in self.entries if (e.estimate.section_id, e.estimate.bundle_id) == (section_id, bundle_id)]
        wanted.sort(key=lambda e: e.estimate.left_unix_s)
        return [e.countable for e in wanted[:limit_count]]

    async def compared_count(self, *, bundle_id: str, shadow_bundle_id: str) -> int:
        estimates = [entry.estimate for entry in self.entries]
        return sum(
            (e.bundle_id, e.shadow_bundle_id) == (bundle_id, shadow_bundle_id) and e.shadow_mu is not None
            for e in estimates
        )

    async def record(
        self,
        *,
        at_unix_s: float,
        actor: str,
        action: Action,
        subject: str,
        reason: str,
        evidence: Mapping[str, str] | None = None,
    ) -> LedgerEntry:
        await self._write()
        entry = entry_after(
            self.ledger_entries[-1],
            at_unix_s=at_unix_s,
            actor=actor,
            action=action,
            subject=subject,
            reason=reason,
            evidence=evidence,
        )
        self.ledger_entries.append(entry)
        return entry

    async def ledger(self, *, limit_count: int) -> Sequence[LedgerEntry]:
        return self.ledger_entries[::-1][:limit_count]

    async def counts(self) -> StoreCounts:
        return StoreCounts(len(self.entries), 0, queued_count=0, queue_limit_count=1)

    async def probe(self) -> None:
        await self._write()

    async def prune(self, *, before_unix_s: float | None, rows_limit_count: int) -> int:
        kept = [e for e in self.entries if before_unix_s is None or e.received_unix_s >= before_unix_s]
        kept = kept[-rows_limit_count:]
        gone = len(self.entries) - len(kept)
        self.entries = kept
        return gone

    async def close(self) -> None:
        self.closed = True

    async def _write(self) -> None:
        await asyncio.sleep(0)
        if self.gate is not None:
            await self.gate.wait()
        if self.error is not None:
            raise self.error


def make_section(
    section_id: str = "bend",
    *,
    radius_m: float = 100.0,
    length_m: float = 200.0,
    speed_limit_mps: float = kph_to_mps(80.0),
    inward_bank_ratio: float = 0.0,
    bank_origin: BankOrigin = BankOrigin.NONE,
) -> RoadSection:
    """A steady left turn (right turn for a negative radius) in the plane."""
    count = round(length_m / 5.0) + 1
    angle_rad = np.linspace(0.0, length_m / abs(radius_m), count)
    nodes_m = np.column_stack(
        [abs(radius_m) * np.sin(angle_rad), radius_m * (1.0 - np.cos(angle_rad)), np.zeros(count)]
    )
    return build_section(
        section_id=section_id,
        name=section_id.title(),
        nodes_m=nodes_m,
        speed_limit_mps=speed_limit_mps,
        # Positive is a rise towards the left edge, which leans outwards in a left turn.
        cross_slope_ratio=np.full(count, -np.sign(radius_m) * inward_bank_ratio),
        bank_origin=bank_origin,
    )


def make_passage(
    section: RoadSection,
    *,
    seed: int = 0,
    mu: float = 0.5,
    age_s: float = 0.0,
    passage_id: bytes | None = None,
    table: FeatureTable = NEWEST_TABLE,
    **changes: Any,
) -> Passage:
    """A passage that can have happened and from which the linear model reads `mu`; different for every seed.

    Features beyond the paper's statistics are zero, or as near to it as their range allows.
    """
    rng = np.random.default_rng(seed)
    count = 100
    sideslip = rng.normal(0.0, 0.01, count)
    signals = (
        rng.normal(0.02, 0.01, count),
        sideslip - sideslip.mean() + (mu - BIAS_MU),
        rng.normal(0.0, 0.1, count),
        rng.normal(0.0, 0.05, count),
        rng.normal(15.0, 0.5, count),
    )
    values = np.clip(0.0, table.minimum, table.maximum)[: len(table.kinematic)]
    values[table.statistics_columns.ravel()] = np.concatenate([statistics_of(signal) for signal in signals])
    values = values.astype(np.float32)
    summary = {
        "values": tuple(float(v) for v in values),
        "table_digest": table.digest,
        "duration_s": section.length_m / float(values[table.index("speed_mean_mps")]),
        "quality": QualityFlag.NONE,
    } | {key: changes.pop(key) for key in ("values", "table_digest", "duration_s", "quality") if key in changes}
    return Passage(
        **(
            {
                "passage_id": rng.bytes(16) if passage_id is None else passage_id,
                "section_id": section.section_id,
                "map_version": section.version,
                "summary": KinematicSummary(**summary),  # type: ignore[arg-type] # a test may put anything there
                "age_s": age_s,
            }
            | changes
        )
    )


def release_of(sequence_number: int, bundle_id: str, *, ring: str = "all", reason: str = "better") -> Release:
    return Release(
        ring=ring,
        sequence_number=sequence_number,
        bundle_id=bundle_id,
        files_sha256={"manifest.json": "a" * 64},
        released_unix_s=int(NOON_UNIX_S),
        released_by="ann",
        reason=reason,
        gate="passed",
        ledger_hash="b" * 64,
    )


class FakeSource:
    """Has the release it is given, or refuses as it is told."""

    def __init__(self) -> None:
        self.release: Release | None = None
        self.refusal: UpdateRefusal | None = None

    def fetch(self, ring: str, *, newer_than: int, into: Path) -> FetchedRelease | UpdateRefusal | None:
        if self.refusal is not None:
            return self.refusal
        if self.release is None or self.release.sequence_number <= newer_than:
            return None
        return FetchedRelease(self.release, into)


class FakeShelf:
    """Keeps its state in memory; survives a restart if handed to the next rollout.

    `error` makes every write fail; bundles in `damaged_ids` are not what was put there;
    `damaged` says that of the state itself.
    """

    def __init__(self) -> None:
        self.kept = RolloutState()
        self.states: list[RolloutState] = []
        self.error: StoreError | None = None
        self.damaged_ids: set[str] = set()
        self.damaged = False

    @property
    def notes(self) -> tuple[str, ...]:
        return ("state.json was damaged",) if self.damaged else ()

    def state(self) -> RolloutState:
        return RolloutState() if self.damaged else self.kept

    def keep_state(self, state: RolloutState) -> None:
        if self.error is not None:
            raise self.error
        self.kept = state
        self.states.append(state)

    def put(self, release: Release, folder: Path) -> ShelvedBundle:
        if self.error is not None:
            raise self.error
        return ShelvedBundle(release.bundle_id, "a" * 64, release.sequence_number, release.ledger_hash, release.gate)

    def folder_of(self, bundle: ShelvedBundle) -> Path:
        if bundle.bundle_id in self.damaged_ids:
            raise BundleError(f"bundle {bundle.bundle_id} differs from its digest")
        return Path(bundle.bundle_id)

    def clear(self, state: RolloutState) -> None:
        pass

    @property
    def incoming_folder(self) -> Path:
        return Path("incoming")
