"""A recording against a unit that has mapped the road anew."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace
from functools import partial

import pytest

from roadgrip.errors import ConfigurationError
from roadgrip.features import PAPER_TABLE
from roadgrip.records import Accepted, Arrival, Passage, Reason, Rejected
from roadgrip.section import RoadSection
from tests.vehicle_client.shell.air import Ether, TokenCodec, Unit
from tests.vehicle_client.shell.cars import WireToUnit
from tests.vehicle_client.synthetic import drive_over, road, s_turn
from vehicle_client.estimation.grip.noise import IDEAL_NOISE
from vehicle_client.estimation.handling import XC90_HANDLING
from vehicle_client.pipeline import Summarised
from vehicle_client.shell.exchange import Ending
from vehicle_client.shell.replay import Replay, send_recorded, summarise_recording
from vehicle_client.vehicle_profile import PAPER_VEHICLE

NEW = road(s_turn)
OLD = replace(NEW, speed_limit_mps=NEW.speed_limit_mps - 3.0)
TRACE, _ = drive_over(s_turn)
STALE = Rejected(Reason.STALE_MAP, "")


@dataclass
class RemappedUnit(Unit):
    """Gets its new map while the vehicle is on its way."""

    new_section: RoadSection = NEW

    def answer(self, frame: bytes, now_s: float) -> list[bytes]:
        frames = super().answer(frame, now_s)
        if isinstance(self.heard[-1], Passage):
            self.section = self.new_section
        return frames


def sent(unit: Unit, section: RoadSection = OLD) -> Replay:
    summarise = partial(summarise_recording, TRACE)
    codec = partial(TokenCodec, unit.codec.ether)
    return asyncio.run(send_recorded(summarise(section), WireToUnit(unit), lambda _: codec(), summarise=summarise))


def versions_in(unit: Unit) -> list[str]:
    return [message.map_version for message in unit.heard if isinstance(message, Passage)]


def test_with_the_map_of_the_unit_nothing_is_done_twice():
    unit = Unit(TokenCodec(Ether()), section=NEW)
    replayed = sent(unit, NEW)
    assert replayed.went_well
    assert not replayed.remapped
    assert versions_in(unit) == [NEW.version]


def test_a_map_that_the_unit_sends_on_arrival_is_summarised_with():
    unit = Unit(TokenCodec(Ether()), section=NEW)
    replayed = sent(unit)
    assert replayed.went_well
    assert (replayed.remapped, replayed.section.version) == (True, NEW.version)
    assert versions_in(unit) == [NEW.version]


def test_a_map_that_is_called_outdated_afterwards_is_fetched_once():
    unit = RemappedUnit(TokenCodec(Ether()), section=OLD, outcomes=[STALE, Accepted()])
    replayed = sent(unit)
    assert replayed.went_well
    assert versions_in(unit) == [OLD.version, NEW.version]
    assert len({m.passage_id for m in unit.heard if isinstance(m, Passage)}) == 2


def test_a_unit_that_calls_every_map_outdated_is_not_asked_for_ever():
    unit = RemappedUnit(TokenCodec(Ether()), section=OLD, outcomes=[STALE])
    replayed = sent(unit)
    assert replayed.record is not None
    assert replayed.record.ending is Ending.REJECTED
    assert versions_in(unit) == [OLD.version, NEW.version]


def test_a_unit_that_does_not_send_its_map_is_said():
    class Silent(Unit):
        def answer(self, frame: bytes, now_s: float) -> list[bytes]:
            frames = super().answer(frame, now_s)
            reported = any(isinstance(message, Passage) for message in self.heard)
            return [] if reported and isinstance(self.heard[-1], Arrival) else frames

    with pytest.raises(ConfigurationError, match="did not answer"):
        sent(Silent(TokenCodec(Ether()), section=OLD, outcomes=[STALE]))


@pytest.mark.parametrize("declared", ["handling", "noise"])
def test_a_recording_is_read_with_what_its_car_declares(declared):
    heavier = replace(XC90_HANDLING, mass_kg=1.3 * XC90_HANDLING.mass_kg)
    other = replace(PAPER_VEHICLE, **({"handling": heavier} if declared == "handling" else {"noise": IDEAL_NOISE}))
    own, changed = (summarise_recording(TRACE, NEW, vehicle=car).made for car in (PAPER_VEHICLE, other))
    assert isinstance(own, Summarised)
    assert isinstance(changed, Summarised)
    statistics = len(PAPER_TABLE.kinematic)
    assert changed.summary.values[:statistics] == own.summary.values[:statistics]
    assert changed.summary.values[statistics:] != own.summary.values[statistics:]
