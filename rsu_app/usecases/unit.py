"""The road side unit itself: all of its state in one place, and everything that may be done to it."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from math import inf

from roadgrip.bundle import BundleManifest
from roadgrip.errors import StoreError, StoreFullError
from roadgrip.features import TABLES
from roadgrip.ledger import WENT_LIVE, Action
from roadgrip.reasons import Reason
from roadgrip.records import (
    Accepted,
    Advisory,
    AdvisoryNotice,
    Beacon,
    FrictionInterval,
    MapOffer,
    Outcome,
    Passage,
    Rejected,
)
from roadgrip.section import RoadSection
from rsu_app.domain.advisory import AdvisoryPolicy
from rsu_app.domain.drift import DriftReport
from rsu_app.domain.plausibility import misdirection
from rsu_app.domain.shadow import ShadowRecord
from rsu_app.domain.watch import MEMORY_WINDOWS_COUNT
from rsu_app.ports import Clock, CountablePassage, FrictionModel, PassageEntry, PassageStore
from rsu_app.usecases.changes import Subscription
from rsu_app.usecases.claims import Claim, Judges, claim_of, groups_of, judged_claims
from rsu_app.usecases.drift_watch import LEARNED_FROM_COUNT
from rsu_app.usecases.limits import UnitLimits
from rsu_app.usecases.readiness import ClockWatch, Readiness, check_golden, model_check, store_check, window_check
from rsu_app.usecases.recall import Recall, outcome_of_repetition
from rsu_app.usecases.restoring import Restoring
from rsu_app.usecases.section_friction import (
    FrictionPolicies,
    SectionFriction,
    published_interval,
    section_advisory,
    section_friction,
)
from rsu_app.usecases.section_state import SectionState, count_passage, section_states
from rsu_app.usecases.shadowing import Shadow

LEDGER_LOOKBACK_COUNT = 1_000
"""Entries among which the newest word on the live model is looked for; if it is older, it is said again."""


class RoadSideUnit:
    """Takes passages in, gives intervals and advisories out; knows no transport.

    Everything here runs on one event loop. Questions are answered from memory at once; only what must reach the
    disk is awaited.

    Args:
        sections: The maps this unit serves, at least one.
        store: Where passages are kept.
        model: The regressor, or None; then passages are refused and the winter speed is advised.
        model_absence: Why there is no model, if there is none; readiness says it.
        clock: Both clocks.
        policy: What the road authority decides about advice.
        section_policies: Decisions for single sections that replace `policy`, by section id.
        friction_policies: What is asked of vehicles before friction is said and advice follows.
        limits: How far things may grow.

    Raises:
        ConfigurationError: The sections or policies contradict themselves.
        BundleError: The model does not answer its golden vectors.
    """

    def __init__(
        self,
        *,
        sections: Iterable[RoadSection],
        store: PassageStore,
        model: FrictionModel | None,
        clock: Clock,
        policy: AdvisoryPolicy | None = None,
        section_policies: Mapping[str, AdvisoryPolicy] | None = None,
        friction_policies: FrictionPolicies | None = None,
        limits: UnitLimits | None = None,
        model_absence: str = "no model is loaded",
    ) -> None:
        self._limits = limits or UnitLimits()
        self._friction_policies = friction_policies or FrictionPolicies()
        change_policy = self._friction_policies.change
        # A change within the last hour can only be told by what was found before.
        self._memory_s = self._limits.window_s * (1 if change_policy is None else MEMORY_WINDOWS_COUNT)
        self._store = store
        self._clock = clock
        self._clock_watch = ClockWatch(clock)
        self._recall = Recall(capacity_count=self._limits.recall_count)
        self._subscribers_count = 0
        self._pending: set[asyncio.Task[list[Outcome]]] = set()
        self._restored = False
        self._restoring = Restoring(store, limit_count=self._limits.restored_count)
        # What the store said of itself when the live model was noted there: after damage it is another.
        self._model_noted_in: tuple[str, ...] | None = None
        self._states = section_states(
            sections,
            policy=policy or AdvisoryPolicy(),
            section_policies=section_policies or {},
            window_s=self._limits.window_s,
            window_capacity_count=self._limits.window_capacity_count,
            change_policy=change_policy,
        )
        if model is not None:
            check_golden(model)
        self._model = model
        self._watch_drift()
        self._model_absence = model_absence
        self._shadow: Shadow | None = None

    @property
    def clock_plausible(self) -> bool:
        """Whether the wall clock can be trusted."""
        return self._clock_watch.plausible

    @property
    def section_ids(self) -> tuple[str, ...]:
        """The sections this unit serves."""
        return tuple(self._states)

    @property
    def table_digests(self) -> tuple[str, ...]:
        """The feature tables that are served: those of the live bundle, all that are known while there is none."""
        return tuple(TABLES) if self._model is None else self._model.manifest.table_digests

    @property
    def model(self) -> FrictionModel | None:
        """The live model."""
        return self._model

    @property
    def shadow(self) -> Shadow | None:
        """The model that is asked beside it; None most of the time."""
        return self._shadow

    @property
    def model_manifest(self) -> BundleManifest | None:
        """What the live model says about itself."""
        return None if self._model is None else self._model.manifest

    async def catch_up(self, *, within_s: float = inf) -> int:
        """Return how many estimates entered the windows by doing what a start does and could not be done yet.

        Restores the windows, for about `within_s`, and writes down which model is live. A clock without the date or a
        disk without room may stand in the way of either; call it again every few seconds until both are done.

        Raises:
            StoreError: The store cannot be read.
        """
        counted_count = 0 if self._restored else await self.restore(within_s=within_s)
        if self._model_noted_in != self._store.notes:
            await self._note_live_model()
        return counted_count

    async def restore(self, *, within_s: float = inf) -> int:
        """Return how many estimates entered the windows again from what the store remembers, the newest first.

        Needs a plausible wall clock, since a stored passage has no other age; without one nothing is restored.
        Passages that were ingested meanwhile are not counted twice. After `within_s` it stops behind a portion, and
        the next call goes on from there.

        Raises:
            StoreError: The store cannot be read.
        """
        if not self._clock_watch.plausible:
            return 0
        since_unix_s = self._clock.unix_s() - self._memory_s
        counted_count, enough_at_s = 0, self._clock.monotonic_s() + within_s
        async for portion in self._restoring.portions(since_unix_s=since_unix_s):
            unix_s, monotonic_s = self._clock.unix_s(), self._clock.monotonic_s()
            for passage in portion:
                age_s = unix_s - passage.estimate.left_unix_s
                counted_count += self._admit(passage, left_at_s=monotonic_s - age_s, age_s=age_s, earlier=True)
            if self._clock.monotonic_s() >= enough_at_s:
                break
        self._restored = self._restoring.done
        self.refresh()
        return counted_count

    async def ingest_passage(self, passage: Passage) -> Outcome:
        """Return what became of a passage, after it is on the disk; see `ingest_passages`."""
        return (await self.ingest_passages([passage]))[0]

    async def ingest_passages(self, passages: Sequence[Passage]) -> list[Outcome]:
        """Return what became of each of some passages that arrived together, after those accepted are on the disk.

        Together they cost a fraction of what they cost one by one: the model is asked once for all passages of a
        section, and one commit holds them. What becomes of one does not depend on the others.

        The same passage sent again gets the same answer and changes nothing, whatever its age says then. If the
        caller stops waiting, the passages are still stored and counted.

        Args:
            passages: What vehicles claim; the age of a passage grows from attempt to attempt.
        """
        received_at_s = self._clock.monotonic_s()
        claims = [claim_of(passage) for passage in passages]
        outcomes = [self._answer_at_once(claim) for claim in claims]
        entries: list[PassageEntry] = []
        places: list[int] = []
        judges = Judges(self._model, self._shadow)
        unix_s, window_s = self._clock.unix_s(), self._limits.window_s
        for group in groups_of([i for i, outcome in enumerate(outcomes) if outcome is None], claims, judges):
            states = [self._states[passages[i].section_id] for i in group]
            answers = judged_claims([claims[i] for i in group], states, judges, unix_s=unix_s, window_s=window_s)
            for i, judged in zip(group, answers, strict=True):
                if isinstance(judged, Rejected):
                    outcomes[i] = judged
                else:
                    entries.append(judged)
                    places.append(i)
        if entries:
            task = asyncio.create_task(self._keep(entries, received_at_s=received_at_s))
            self._pending.add(task)
            task.add_done_callback(self._pending.discard)
            for i, outcome in zip(places, await asyncio.shield(task), strict=True):
                outcomes[i] = outcome
        return [outcome for outcome in outcomes if outcome is not None]

    def _answer_at_once(self, claim: Claim) -> Outcome | None:
        """Return the answer to a passage that needs no model: known already, or for no map of ours. None: go on."""
        passage, marks = claim.passage, claim.marks
        known = self._recall.find(passage_id=passage.passage_id, values=marks.values_digest)
        if known is not None:
            return outcome_of_repetition(known, passage_id=passage.passage_id, content=marks.content_digest)
        state = self._states.get(passage.section_id)
        if state is None:
            return self._unknown(passage.section_id)
        return misdirection(passage, state.section, table_digests=self.table_digests)

    def current_interval(self, section_id: str) -> FrictionInterval | Rejected | None:
        """Return the friction interval of a section as of now, None if no vehicle is behind it."""
        state = self._states.get(section_id)
        return self._unknown(section_id) if state is None else self._interval(state)

    def current_friction(self, section_id: str) -> SectionFriction | Rejected | None:
        """Return the interval of a section with the second opinion beside it, None if no vehicle is behind it."""
        state = self._states.get(section_id)
        if state is None:
            return self._unknown(section_id)
        return section_friction(state, now_s=self._clock.monotonic_s(), policies=self._friction_policies)

    def current_drift(self, section_id: str) -> DriftReport | Rejected | None:
        """Return whether a section's traffic was what the live model was made for, when `watch_drift` looked last."""
        state = self._states.get(section_id)
        return self._unknown(section_id) if state is None else state.drift.latest

    async def watch_drift(self) -> None:
        """Look at each section that had traffic since the last look; call it every few minutes.

        Raises:
            StoreError: What traffic was like before cannot be read.
        """
        for section_id, state in self._states.items():
            if (manifest := self.model_manifest) is not None and state.drift.has_news:
                await state.drift.learn_earlier(
                    partial(self._store.load_first, section_id=section_id, limit_count=LEARNED_FROM_COUNT)
                )
                await state.drift.look(manifest, now_s=self._clock.monotonic_s())

    def current_advisory(self, section_id: str) -> Advisory | Rejected:
        """Return what drivers on a section are told now."""
        state = self._states.get(section_id)
        return self._unknown(section_id) if state is None else self._advisory(state)

    def advisory_notice(self, section_id: str) -> AdvisoryNotice | Rejected:
        """Return the advisory of a section bound to its map and to the time, ready to be sent."""
        state = self._states.get(section_id)
        return self._unknown(section_id) if state is None else self._notice(state)

    def map_offer(self, section_id: str) -> MapOffer | Rejected:
        """Return the map of a section with the feature tables that are served."""
        state = self._states.get(section_id)
        if state is None:
            return self._unknown(section_id)
        return MapOffer(section=state.section, table_digests=self.table_digests)

    def beacon(self, section_id: str) -> Beacon | Rejected:
        """Return the announcement of a section."""
        state = self._states.get(section_id)
        if state is None:
            return self._unknown(section_id)
        advisory = self._advisory(state)
        return Beacon(
            section_id=section_id,
            map_version=state.section.version,
            speed_mps=advisory.speed_mps,
            reason=advisory.reason,
            confidence=advisory.confidence,
            valid_for_s=advisory.valid_for_s,
            issued_unix_s=self._issued_unix_s(),
        )

    def subscribe(self, section_id: str) -> Subscription | Rejected:
        """Return the advisory notices of a section from now on; busy when too many listen already."""
        state = self._states.get(section_id)
        if state is None:
            return self._unknown(section_id)
        if self._subscribers_count >= self._limits.subscribers_count:
            return Rejected(Reason.BUSY, f"{self._limits.subscribers_count} listeners are as many as this unit serves")

        def leave(subscription: Subscription) -> None:
            state.listeners.discard(subscription)
            self._subscribers_count -= 1

        subscription = Subscription(lambda: self._notice(state), leave)
        state.listeners.add(subscription)
        self._subscribers_count += 1
        return subscription

    def refresh(self) -> None:
        """Let time pass: forget what is too old and tell listeners whose advisory changed by that.

        Call it every few seconds. Answers are right without; only listeners would learn late.
        """
        for state in self._states.values():
            before = state.advisory
            after = self._advisory(state)
            if before is None or (before.speed_mps, before.reason) != (after.speed_mps, after.reason):
                _notify(state)

    def switch_model(self, model: FrictionModel) -> None:
        """Make a model the live one, after it has answered its golden vectors.

        The incumbent answers until then: whatever is judged by one model is judged by it alone, and nothing waits.
        Estimates it gave stay in the windows.

        Raises:
            BundleError: The candidate misses its golden vectors; the incumbent stays.
        """
        check_golden(model)
        self._model = model
        self._model_noted_in = None
        self._watch_drift()
        self.refresh()

    def begin_shadow(self, model: FrictionModel, *, newer: bool, earlier_count: int = 0) -> None:
        """Ask a model about every passage from now on, beside the live one.

        Args:
            model: It; takes the place of one that was asked before.
            newer: Whether it is a candidate, and not the one before.
            earlier_count: Passages that the two were compared by before the unit was started again.
        """
        self._shadow = Shadow(model, newer, ShadowRecord(earlier_count))

    def end_shadow(self) -> None:
        """Ask the live model alone from now on."""
        self._shadow = None

    async def _note_live_model(self) -> None:
        """Write into the ledger which model is live now, if its newest word on that is another.

        A unit that restarts every minute does not fill its ledger, and a store that cannot write stops no model.
        """
        manifest = self.model_manifest
        subject = "" if manifest is None else manifest.bundle_id
        try:
            entries = await self._store.ledger(limit_count=LEDGER_LOOKBACK_COUNT)
            if subject != next((entry.subject for entry in entries if entry.action in WENT_LIVE), None):
                await self._store.record(
                    at_unix_s=self._clock.unix_s(),
                    actor="unit",
                    action=Action.LIVE,
                    subject=subject,
                    reason=self._model_absence if manifest is None else manifest.name,
                )
        except StoreError:
            return
        self._model_noted_in = self._store.notes if manifest is self.model_manifest else None

    async def prune(self) -> int:
        """Return how many passages were deleted to stay within the store's budget.

        Ages are only judged by a clock that is plausible and steady.

        Raises:
            StoreError: The store does not answer.
        """
        clock = self._clock_watch.check()
        before_unix_s = self._clock.unix_s() - self._limits.retention_s if clock.ok else None
        return await self._store.prune(before_unix_s=before_unix_s, rows_limit_count=self._limits.rows_count)

    async def readiness(self) -> Readiness:
        """Return whether the unit can do its work right now, with the reason for every doubt."""
        return Readiness(
            checks=(
                model_check(self._model, absence=self._model_absence),
                await store_check(self._store),
                self._clock_watch.check(),
                *(window_check(section_id, self._interval(state)) for section_id, state in self._states.items()),
            )
        )

    async def close(self) -> None:
        """Wait for passages that are being stored, end all subscriptions, then close the store."""
        if self._pending:
            await asyncio.wait(self._pending)
        for state in self._states.values():
            for subscription in tuple(state.listeners):
                subscription.close()
        await self._store.close()

    async def _keep(self, entries: Sequence[PassageEntry], *, received_at_s: float) -> list[Outcome]:
        """Return the outcome of each entry after the commit; only then do its estimates count."""
        try:
            held = await self._store.append(entries)
        except StoreFullError as error:
            return [Rejected(Reason.BUSY, str(error))] * len(entries)
        except StoreError as error:
            return [Rejected(Reason.STORE_UNAVAILABLE, str(error))] * len(entries)
        outcomes = [
            self._count_stored(entry, received_at_s=received_at_s)
            if known is None
            else outcome_of_repetition(
                known, passage_id=entry.estimate.passage_id, content=entry.estimate.content_digest
            )
            for entry, known in zip(entries, held, strict=True)
        ]
        for section_id in {entry.estimate.section_id for entry in entries}:
            state = self._states[section_id]
            if state.listeners:
                # Whoever asks is told what holds then; only who listens must be told that it changed.
                self._advisory(state)
                _notify(state)
        return outcomes

    def _count_stored(self, entry: PassageEntry, *, received_at_s: float) -> Accepted:
        countable, age_s = entry.countable, entry.passage.age_s
        if self._admit(countable, left_at_s=received_at_s - age_s, age_s=age_s):
            self._states[entry.estimate.section_id].drift.learn(countable)
        return Accepted(entry.estimate.flags)

    def _admit(self, passage: CountablePassage, *, left_at_s: float, age_s: float, earlier: bool = False) -> bool:
        """Remember a stored passage and return whether it counts from now on.

        Once only: restoring may read a passage back between its commit and the moment its sender is answered.

        Args:
            passage: What the store holds.
            left_at_s: When the vehicle left the section, by the monotonic clock.
            age_s: How long ago that is, by the clock that knows.
            earlier: It arrived before all that is remembered.
        """
        estimate = passage.estimate
        if estimate.passage_id in self._recall:
            return False
        self._recall.remember(estimate, earlier=earlier)
        state = self._states.get(estimate.section_id)
        if state is None:
            return False
        state.drift.note(passage, left_at_s=left_at_s)
        return count_passage(state, passage, left_at_s=left_at_s, age_s=age_s)

    def _watch_drift(self) -> None:
        """Let every section's watch know which bundle it looks at."""
        manifest = self.model_manifest
        for state in self._states.values():
            state.drift.begin("" if manifest is None else manifest.bundle_id)

    def _interval(self, state: SectionState) -> FrictionInterval | None:
        return published_interval(state, now_s=self._clock.monotonic_s(), policies=self._friction_policies)

    def _advisory(self, state: SectionState) -> Advisory:
        return section_advisory(
            state,
            now_s=self._clock.monotonic_s(),
            model_live=self._model is not None,
            policies=self._friction_policies,
        )

    def _notice(self, state: SectionState) -> AdvisoryNotice:
        return AdvisoryNotice(
            section_id=state.section.section_id,
            map_version=state.section.version,
            advisory=self._advisory(state),
            issued_unix_s=self._issued_unix_s(),
        )

    def _issued_unix_s(self) -> int:
        return int(self._clock.unix_s()) if self._clock_watch.plausible else 0

    def _unknown(self, section_id: str) -> Rejected:
        return Rejected(Reason.UNKNOWN_SECTION, f"{section_id[:48]!r} is none of {', '.join(self._states)}")


def _notify(state: SectionState) -> None:
    for subscription in tuple(state.listeners):
        subscription.notify()
