"""A unit on fakes, where the use cases' tests begin."""

from __future__ import annotations

from roadgrip.records import (
    Accepted,
    Advisory,
    FrictionInterval,
    Rejected,
)
from rsu_app.usecases import RoadSideUnit, UnitLimits
from rsu_app.usecases.section_state import SectionState
from tests.rsu_app.fakes import FakeClock, FakeModel, FakeStore, make_passage, make_section

SECTION = make_section()
OTHER = make_section("other", radius_m=-60.0)
MODEL = FakeModel()
"""For tests that build many sites and never change what the model answers."""


class Site:
    """A unit on fakes, with the fakes at hand."""

    def __init__(self, *, model=None, store=None, clock=None, limits=None, without_model=False, **options):
        self.clock = clock or FakeClock()
        self.store = store or FakeStore()
        self.model: FakeModel = model or FakeModel()
        self.unit = RoadSideUnit(
            sections=[SECTION, OTHER],
            store=self.store,
            model=None if without_model else self.model,
            clock=self.clock,
            limits=limits or UnitLimits(),
            **options,
        )

    async def ingest_many(self, count, *, mu=0.5, section=SECTION, first_seed=0):
        passages = [make_passage(section, seed=first_seed + i, mu=mu) for i in range(count)]
        return [await self.unit.ingest_passage(passage) for passage in passages]

    def interval(self, section=SECTION) -> FrictionInterval:
        interval = self.unit.current_interval(section.section_id)
        assert isinstance(interval, FrictionInterval)
        return interval

    def advisory(self, section=SECTION) -> Advisory:
        advisory = self.unit.current_advisory(section.section_id)
        assert isinstance(advisory, Advisory)
        return advisory

    def state(self, section=SECTION) -> SectionState:
        """What the unit holds for a section; nobody but tests asks."""
        return self.unit._states[section.section_id]  # noqa: SLF001 - it answers only for what follows from it

    def restarted(self, *, limits=None):
        return Site(store=self.store, clock=self.clock, model=self.model, limits=limits)


def flags_of(outcome):
    assert isinstance(outcome, Accepted)
    return outcome.flags


def reason_of(outcome):
    assert isinstance(outcome, Rejected)
    return outcome.reason
