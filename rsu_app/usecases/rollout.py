"""From a release to a live bundle and back: installs, shadows, switches, confirms, rejects, rolls back.

Every step that changes what the unit would start with is on the disk before it is taken; only a step back is taken
first, since a model that misleads drivers must not stay for a full disk's sake. Each step is told to the ledger.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from roadgrip.errors import BundleError, FeatureTableError, StoreError
from roadgrip.ledger import Action
from roadgrip.release import Release
from rsu_app.domain.rollout import (
    FACTORY,
    RolloutState,
    ShelvedBundle,
    Stage,
    confirmed,
    installed,
    rejected,
    rolled_back,
    switched,
    takes_up,
)
from rsu_app.domain.shadow import Comparison, ShadowPolicy, Verdict, verdict
from rsu_app.ports import Clock, FrictionModel, PassageStore
from rsu_app.rollout_ports import BundleShelf, FetchedRelease, ReleaseSource, UpdateReason, UpdateRefusal
from rsu_app.usecases.booting import Boot, Loading
from rsu_app.usecases.readiness import check_golden
from rsu_app.usecases.unit import RoadSideUnit

PROBE_PERIOD_S = 10.0
"""How often the live model is asked for its golden vectors while there is one to go back to."""
UNIT = "unit"
"""Who acts when nobody told the unit to."""


@dataclass(frozen=True, slots=True)
class RolloutStatus:
    """Where the rollout stands.

    Attributes:
        state: What the shelf is for.
        comparison: How far apart the two bundles are that are asked side by side; None with a single one.
        wanted_count: Passages after which the comparison is over; 0 with a single one.
        last_refusal: Why the latest look at the repository took nothing; None if it did, or nothing was looked at.
        looked_unix_s: When the repository was looked at last; None if never since the start.
    """

    state: RolloutState
    comparison: Comparison | None
    wanted_count: int
    last_refusal: UpdateRefusal | None
    looked_unix_s: float | None


class Rollout:
    """Takes releases up and watches what becomes of them. All of it on the unit's event loop.

    Args:
        unit: Runs the live model.
        store: Keeps the ledger.
        shelf: Keeps bundles and the state.
        loading: Makes models of bundles.
        source: Where releases come from; None where nobody configured one.
        ring: The unit's own.
        policy: What a new bundle has to stand.
        clock: Both clocks.
        started: What the unit started with.
        on_refusal: Told of every release that is not taken, for the metric and the log.
    """

    def __init__(
        self,
        *,
        unit: RoadSideUnit,
        store: PassageStore,
        shelf: BundleShelf,
        loading: Loading,
        source: ReleaseSource | None,
        ring: str,
        policy: ShadowPolicy,
        clock: Clock,
        started: Boot,
        on_refusal: Callable[[UpdateRefusal], None] = lambda _: None,
    ) -> None:
        self._unit = unit
        self._store = store
        self._shelf = shelf
        self._loading = loading
        self._source = source
        self._ring = ring
        self._policy = policy
        self._clock = clock
        self._state = started.state
        self._left_behind = "; ".join(started.notes) if started.left_behind else ""
        self._on_refusal = on_refusal
        self._turn = asyncio.Lock()
        self._looking = asyncio.Lock()
        self._last_refusal: UpdateRefusal | None = None
        self._looked_unix_s: float | None = None
        self._probed_at_s: float | None = None

    @property
    def status(self) -> RolloutStatus:
        """Where the rollout stands."""
        shadow = self._unit.shadow
        return RolloutStatus(
            state=self._state,
            comparison=None if shadow is None else shadow.record.comparison(),
            wanted_count=0 if shadow is None else self._wanted_count,
            last_refusal=self._last_refusal,
            looked_unix_s=self._looked_unix_s,
        )

    async def resume(self) -> None:
        """Go on from where the unit stood when it stopped: compare again what was being compared."""
        async with self._turn:
            if self._left_behind:
                why, self._left_behind = self._left_behind, ""
                await self._tell(Action.ROLLED_BACK, self.live_id, reason=why)
                with contextlib.suppress(StoreError):  # a disk that cannot be written now is no reason not to start
                    await self._keep(self._state)
            beside = self._state.candidate if self._state.stage is Stage.SHADOW else self._state.previous
            if self._state.stage is Stage.SETTLED or beside is None:
                return
            try:
                model = await self._load(beside)
            except (BundleError, FeatureTableError, StoreError) as error:
                await self._give_up_comparing(str(error))
                return
            self._unit.begin_shadow(
                model, newer=self._state.stage is Stage.SHADOW, earlier_count=await self._compared_count(model)
            )

    async def look(self, *, actor: str = UNIT) -> Release | UpdateRefusal | None:
        """Return the release that the configured source had news of and that was taken up, None without news."""
        if self._source is None:
            return UpdateRefusal(
                UpdateReason.NOT_CONFIGURED, "updates.source and updates.trusted_root say where releases come from"
            )
        return await self.update_from(self._source, actor=actor)

    async def update_from(self, source: ReleaseSource, *, actor: str) -> Release | UpdateRefusal | None:
        """Return the release that a source had news of, now in the shadow; None without news, or why it was refused.

        Args:
            source: The configured one, or a folder that somebody brought.
            actor: Who asked for it.
        """
        async with self._looking:
            # Not in turn with the steps: a slow line must not keep a misleading model in its place.
            found = await asyncio.to_thread(
                source.fetch,
                self._ring,
                newer_than=self._state.newest_sequence_number,
                into=self._shelf.incoming_folder,
            )
            async with self._turn:
                return await self._found(found, actor=actor)

    async def watch(self) -> None:
        """Look at what is compared and at the live model, and do what follows. Call it every second or so."""
        async with self._turn:
            trouble = self._trouble() if self._state.previous is not None and self._probe_is_due() else None
            if trouble is not None:
                await self._step_back(f"the live model fails its probe: {trouble}", actor=UNIT)
                return
            shadow = self._unit.shadow
            if shadow is None:
                return
            found, why = verdict(shadow.record.comparison(), self._policy, wanted_count=self._wanted_count)
            if found is Verdict.GO_ON:
                return
            if self._state.stage is Stage.SHADOW:
                await (self._switch(why, actor=UNIT) if found is Verdict.PASSED else self._reject(why))
            elif found is Verdict.PASSED:
                await self._confirm(why)
            else:
                await self._step_back(why, actor=UNIT)

    async def switch_now(self, reason: str, *, actor: str) -> UpdateRefusal | None:
        """Make the candidate live without waiting for the shadow to end; None once it is."""
        async with self._turn:
            if self._state.candidate is None:
                return UpdateRefusal(UpdateReason.NO_RELEASE, "nothing is in the shadow")
            await self._switch(reason, actor=actor)
            return None

    async def roll_back(self, reason: str, *, actor: str) -> UpdateRefusal | None:
        """Step back to the bundle before, or take the candidate off if the live one is settled; None once it is done.

        What is stepped back from is not taken up again, unless a new release brings it.
        """
        async with self._turn:
            if self._state.stage is Stage.SHADOW:
                await self._reject(reason, actor=actor)
                return None
            if self._state.previous is None:
                return UpdateRefusal(UpdateReason.NO_RELEASE, "there is no bundle to go back to")
            return await self._step_back(reason, actor=actor)

    # What the steps are made of; each is called with the turn taken. -------------------------------------------------

    async def _found(
        self, found: FetchedRelease | UpdateRefusal | None, *, actor: str
    ) -> Release | UpdateRefusal | None:
        self._looked_unix_s = self._clock.unix_s()
        if found is None:
            self._last_refusal = None
            return None
        outcome = found if isinstance(found, UpdateRefusal) else await self._take_up(found, actor=actor)
        if isinstance(outcome, UpdateRefusal):
            await self._refuse(outcome)
        else:
            self._last_refusal = None
        return outcome

    async def _take_up(self, found: FetchedRelease, *, actor: str) -> Release | UpdateRefusal:
        release = found.release
        if not takes_up(self._state, release.sequence_number) or found.folder is None:
            return UpdateRefusal(
                UpdateReason.DOWNGRADE,
                f"release {release.sequence_number} is not newer than {self._state.newest_sequence_number}",
            )
        if self._unit.model_manifest is None:
            return await self._take_up_at_once(found, actor=actor)
        try:
            shelved, model = await self._shelve(release, found.folder)
            await self._keep(installed(self._state, shelved))
        except (BundleError, FeatureTableError, StoreError) as error:
            return _refusal_of(error, release)
        await self._tell(
            Action.INSTALLED, release.bundle_id, reason=release.reason, evidence=_evidence(release), actor=actor
        )
        if self._state.candidate is None:  # it is live already; only its release is newer
            return release
        self._unit.begin_shadow(model, newer=True)
        await self._tell(
            Action.SHADOWING,
            release.bundle_id,
            reason=f"answers its golden vectors here; {self._policy.shadow_count} passages beside the live bundle",
        )
        if self._policy.shadow_count == 0:
            await self._switch("no passages in the shadow are asked for", actor=UNIT)
        return release

    async def _take_up_at_once(self, found: FetchedRelease, *, actor: str) -> Release | UpdateRefusal:
        """Make a release live in a unit that has no model: there is nothing to compare it with, or to lose."""
        release = found.release
        assert found.folder is not None  # noqa: S101 - the caller looked
        try:
            shelved, model = await self._shelve(release, found.folder)
            before = self._state
            await self._keep(
                switched(installed(RolloutState(newest_sequence_number=before.newest_sequence_number), shelved))
            )
        except (BundleError, FeatureTableError, StoreError) as error:
            return _refusal_of(error, release)
        self._unit.switch_model(model)
        await self._tell(
            Action.INSTALLED, release.bundle_id, reason=release.reason, evidence=_evidence(release), actor=actor
        )
        await self._tell(Action.SWITCHED, release.bundle_id, reason="the unit had no model")
        with contextlib.suppress(StoreError):  # then the next start confirms it
            await self._keep(confirmed(self._state))
        return release

    async def _shelve(self, release: Release, folder: Path) -> tuple[ShelvedBundle, FrictionModel]:
        """Return a bundle on the shelf and its model, which has answered its golden vectors on this machine."""

        def shelve() -> tuple[ShelvedBundle, FrictionModel]:
            shelved = self._shelf.put(release, folder)
            return shelved, self._loading.from_folder(self._shelf.folder_of(shelved))

        return await asyncio.to_thread(shelve)

    async def _switch(self, reason: str, *, actor: str) -> None:
        shadow, incumbent = self._unit.shadow, self._unit.model
        if shadow is None:
            await self._reject("its model is not loaded")
            return
        try:
            check_golden(shadow.model)
            await self._keep(switched(self._state))
        except BundleError as error:
            await self._reject(str(error))
            return
        except StoreError as error:
            await self._refuse(UpdateRefusal(UpdateReason.NO_ROOM, f"the switch cannot be written down: {error}"))
            return
        self._unit.switch_model(shadow.model)
        self._unit.end_shadow()
        if incumbent is not None:
            self._unit.begin_shadow(incumbent, newer=False)
        await self._tell(Action.SWITCHED, self.live_id, reason=reason, actor=actor, evidence=self._lineage)

    async def _confirm(self, reason: str) -> None:
        try:
            await self._keep(confirmed(self._state))
        except StoreError:
            return  # asked again in a second
        self._unit.end_shadow()
        await self._tell(Action.CONFIRMED, self.live_id, reason=reason)

    async def _reject(self, reason: str, *, actor: str = UNIT) -> None:
        candidate = self._state.candidate
        self._unit.end_shadow()
        try:
            await self._keep(rejected(self._state))
        except StoreError as error:
            self._state = rejected(self._state)
            reason = f"{reason} (this could not be written down: {error})"
        await self._tell(Action.REJECTED, "" if candidate is None else candidate.bundle_id, reason=reason, actor=actor)

    async def _step_back(self, reason: str, *, actor: str) -> UpdateRefusal | None:
        """Answer by the bundle before from this moment on; write it down afterwards."""
        previous, failed_id = self._state.previous, self.live_id
        assert previous is not None  # noqa: S101 - the callers looked
        shadow = self._unit.shadow
        try:
            model = shadow.model if shadow is not None and not shadow.newer else await self._load(previous)
            check_golden(model)
        except (BundleError, FeatureTableError, StoreError) as error:
            refusal = UpdateRefusal(UpdateReason.UNUSABLE_BUNDLE, f"the bundle before cannot be used: {error}")
            await self._refuse(refusal)
            return refusal
        self._unit.end_shadow()
        self._unit.switch_model(model)
        try:
            await self._keep(rolled_back(self._state))
        except StoreError as error:
            self._state = rolled_back(self._state)
            reason = f"{reason} (this could not be written down: {error})"
        await self._tell(
            Action.ROLLED_BACK, self.live_id, reason=reason, actor=actor, evidence={"failed_bundle_id": failed_id}
        )
        return None

    async def _give_up_comparing(self, why: str) -> None:
        if self._state.stage is Stage.SHADOW:
            await self._reject(f"it cannot be loaded any more: {why}")
        else:
            await self._confirm(f"the bundle before cannot be loaded any more: {why}")

    async def _compared_count(self, beside: FrictionModel) -> int:
        """Return by how many stored passages the live bundle and another were compared; none if nobody can tell."""
        try:
            return await self._store.compared_count(bundle_id=self.live_id, shadow_bundle_id=beside.manifest.bundle_id)
        except StoreError:
            return 0

    def _probe_is_due(self) -> bool:
        now_s = self._clock.monotonic_s()
        if self._probed_at_s is not None and now_s - self._probed_at_s < PROBE_PERIOD_S:
            return False
        self._probed_at_s = now_s
        return True

    def _trouble(self) -> str | None:
        """Return what is wrong with the live model; None while it answers its golden vectors."""
        model = self._unit.model
        if model is None:
            return None
        try:
            check_golden(model)
        except BundleError as error:
            return str(error)
        return None

    async def _load(self, bundle: ShelvedBundle) -> FrictionModel:
        def load() -> FrictionModel:
            if bundle.from_factory:
                return self._loading.factory()
            return self._loading.from_folder(self._shelf.folder_of(bundle))

        return await asyncio.to_thread(load)

    async def _keep(self, state: RolloutState) -> None:
        """Write a state down, then act by it and remove what it needs no more."""
        await asyncio.to_thread(self._shelf.keep_state, state)
        self._state = state
        await asyncio.to_thread(self._shelf.clear, state)

    async def _refuse(self, refusal: UpdateRefusal) -> None:
        """Tell of a release that was not taken; the ledger hears of the same refusal once, not at every look."""
        repeated = self._last_refusal is not None and self._last_refusal.reason == refusal.reason
        self._last_refusal = refusal
        self._on_refusal(refusal)
        if not repeated:
            await self._tell(Action.REFUSED, self._ring, reason=f"{refusal.reason.value}: {refusal.detail}")

    async def _tell(
        self,
        action: Action,
        subject: str,
        *,
        reason: str,
        actor: str = UNIT,
        evidence: Mapping[str, str] | None = None,
    ) -> None:
        """Tell the ledger. A store that cannot write stops no step: the next start notices what is missing."""
        try:
            await self._store.record(
                at_unix_s=self._clock.unix_s(),
                actor=actor,
                action=action,
                subject=subject,
                reason=reason,
                evidence=evidence,
            )
        except StoreError as error:
            self._on_refusal(UpdateRefusal(UpdateReason.NO_ROOM, f"the ledger could not be written: {error}"))

    @property
    def live_id(self) -> str:
        """The bundle that vehicles are answered by; empty without one."""
        manifest = self._unit.model_manifest
        return "" if manifest is None else manifest.bundle_id

    @property
    def _lineage(self) -> Mapping[str, str]:
        live = self._state.live
        if live == FACTORY:
            return {}
        return {
            "sequence_number": str(live.sequence_number),
            "laboratory_ledger_hash": live.ledger_hash,
            "gate": live.gate,
        }

    @property
    def _wanted_count(self) -> int:
        return self._policy.shadow_count if self._state.stage is Stage.SHADOW else self._policy.probation_count


def _evidence(release: Release) -> dict[str, str]:
    return {
        "ring": release.ring,
        "sequence_number": str(release.sequence_number),
        "released_by": release.released_by,
        "gate": release.gate,
        "laboratory_ledger_hash": release.ledger_hash,
    }


def _refusal_of(error: Exception, release: Release) -> UpdateRefusal:
    reason = UpdateReason.NO_ROOM if isinstance(error, StoreError) else UpdateReason.UNUSABLE_BUNDLE
    return UpdateRefusal(reason, f"release {release.sequence_number}: {error}")
