"""A unit with a rollout on fakes, where the rollout's tests begin."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np

from roadgrip.errors import BundleError
from roadgrip.ledger import Action
from roadgrip.release import Release
from rsu_app.domain.rollout import Stage
from rsu_app.domain.shadow import ShadowPolicy
from rsu_app.ports import Estimates
from rsu_app.rollout_ports import FetchedRelease, UpdateRefusal
from rsu_app.usecases.booting import Loading, boot
from rsu_app.usecases.rollout import Rollout
from tests.bundles import make_manifest
from tests.rsu_app.fakes import FakeModel, FakeShelf, FakeSource, make_passage, release_of
from tests.rsu_app.usecases.site import SECTION, Site

POLICY = ShadowPolicy(shadow_count=5, probation_count=5, judged_from_count=3)


class BiasedModel(FakeModel):
    """Answers its golden vectors, and anything else times a factor, once it is told to."""

    def __init__(self, steer_weight: float, factor: float = 1.0) -> None:
        super().__init__(make_manifest(weights={"sideslip_mean_rad": 1.0, "steer_mean_rad": steer_weight}))
        self.factor = factor

    def estimate(self, table_digest, rows, *, section_id=None):
        if len(rows) > 1:  # the golden vectors
            model = self.manifest.models[0]
            if self.error is not None:
                raise self.error
            return Estimates(np.array(model.golden.mu), None)
        answer = super().estimate(table_digest, rows, section_id=section_id)
        return replace(answer, mu=answer.mu * self.factor)


class SlowSource(FakeSource):
    """Has no news, and says so only when it is told to."""

    def __init__(self, arrived: threading.Event) -> None:
        super().__init__()
        self._arrived = arrived

    def fetch(self, ring: str, *, newer_than: int, into: Path) -> FetchedRelease | UpdateRefusal | None:
        self._arrived.wait()
        return super().fetch(ring, newer_than=newer_than, into=into)


class Depot:
    """A unit with a rollout on fakes; `models` are the bundles that can be loaded, by their ids."""

    def __init__(self, *, policy: ShadowPolicy = POLICY, shelf=None, site=None, factory=True, models=None) -> None:
        self.factory = FakeModel() if factory else None
        self.shelf = shelf or FakeShelf()
        self.source = FakeSource()
        self.models: dict[str, FakeModel] = models or {}
        self.refusals: list[UpdateRefusal] = []
        self.loading = Loading(from_folder=self.load, factory=self.load_factory)
        self.started = boot(self.shelf, self.loading)
        self.site = Site(
            model=self.started.model,
            without_model=self.started.model is None,
            store=site and site.store,
            clock=site and site.clock,
        )
        self.rollout = Rollout(
            unit=self.site.unit,
            store=self.site.store,
            shelf=self.shelf,
            loading=self.loading,
            source=self.source,
            ring="all",
            policy=policy,
            clock=self.site.clock,
            started=self.started,
            on_refusal=self.refusals.append,
        )
        self.seed = 0

    def load(self, folder: Path) -> FakeModel:
        if folder.name not in self.models:
            raise BundleError(f"{folder} does not answer its golden vectors")
        return self.models[folder.name]

    def load_factory(self) -> FakeModel:
        if self.factory is None:
            raise BundleError("the packaged bundle is for another feature table")
        return self.factory

    def release(self, number: int, model: FakeModel) -> Release:
        """Let the source have news of a model."""
        bundle_id = model.manifest.bundle_id
        self.models[bundle_id] = model
        self.source.release = release_of(number, bundle_id)
        return self.source.release

    async def drive(self, count: int) -> list[object]:
        """Let vehicles pass, and look at the rollout after each."""
        outcomes: list[object] = []
        for _ in range(count):
            self.seed += 1
            outcomes.append(await self.site.unit.ingest_passage(make_passage(SECTION, seed=self.seed)))
            await self.rollout.watch()
        return outcomes

    async def settle(self, number: int, model: FakeModel) -> None:
        """Bring a release to its end."""
        self.release(number, model)
        await self.rollout.look()
        await self.drive(POLICY.shadow_count + POLICY.probation_count)
        assert self.stage is Stage.SETTLED

    @property
    def stage(self) -> Stage:
        return self.rollout.status.state.stage

    @property
    def live_id(self) -> str:
        return self.rollout.live_id

    def restarted(self) -> Depot:
        again = Depot(shelf=self.shelf, site=self.site, models=self.models)
        again.seed = self.seed + 1_000
        return again

    @property
    def told(self) -> list[tuple[Action, str]]:
        return [(entry.action, entry.subject) for entry in self.site.store.ledger_entries[1:]]


GOOD = BiasedModel(1e-3)
OTHER = BiasedModel(2e-3)
GOOD_ID, OTHER_ID = GOOD.manifest.bundle_id, OTHER.manifest.bundle_id
