"""Laws of everything a car knows about sections, whatever is heard, learnt and answered in whatever order."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from roadgrip.records import Reason
from roadgrip.sections import read_section
from vehicle_client.mapmatch.approach import TRIES_LIMIT_COUNT, Moment, SummariseOrder
from vehicle_client.mapmatch.section_line import line_of_section
from vehicle_client.mapmatch.surroundings import (
    LINES_LIMIT_COUNT,
    PASSES_LIMIT_COUNT,
    CloseOrder,
    OpenOrder,
    Order,
    Position,
    Surroundings,
)

ROAD = read_section("long-turn")
LINE = line_of_section(ROAD)
NAMES = st.integers(0, 39).map(lambda number: f"section-{number}")


class AnyOrder(RuleBasedStateMachine):
    """Beacons, maps, positions and answers as they come."""

    def __init__(self) -> None:
        super().__init__()
        self.surroundings = Surroundings()
        self.time_s, self.driven_m = 0.0, 0.0
        self.open: set[str] = set()
        self.asked: set[str] = set()
        self.tries: dict[str, int] = {}
        self.left_s: dict[str, float] = {}

    @property
    def moment(self) -> Moment:
        return Moment(self.time_s, self.driven_m, 20.0)

    def take(self, orders: tuple[Order, ...]) -> None:
        for order in orders:
            match order:
                case OpenOrder(name):
                    assert name not in self.open
                    self.open.add(name)
                    self.tries[name] = 0
                case SummariseOrder(name, _, since_s):
                    assert name in self.open
                    assert name not in self.asked
                    self.asked.add(name)
                    self.tries[name] += 1
                    assert self.tries[name] <= TRIES_LIMIT_COUNT
                    assert since_s >= self.left_s.get(name, since_s)
                case CloseOrder(name):
                    assert name in self.open
                    self.open.discard(name)
                    self.asked.discard(name)

    @rule(name=NAMES)
    def hear(self, name: str) -> None:
        self.take(self.surroundings.hear(name, self.moment))

    @rule(name=NAMES, has_map=st.booleans(), placeless=st.booleans())
    def learn(self, name: str, has_map: bool, placeless: bool) -> None:
        plane = None if placeless else LINE.plane
        self.surroundings.learn(replace(LINE, section_id=name, plane=plane), has_map=has_map)

    @rule(
        distance_m=st.sampled_from([0.0, 2.0, 60.0, 400.0, 3_000.0]), anchor=st.none() | st.sampled_from(ROAD.anchors)
    )
    def move(self, distance_m: float, anchor: object) -> None:
        self.time_s += 0.1 + distance_m / 20.0
        self.driven_m += distance_m
        fix = None if anchor is None else Position(self.time_s, anchor.lat_deg, anchor.lon_deg, 2.0)  # type: ignore[attr-defined]
        self.take(self.surroundings.move(self.moment, fix))

    @rule(reason=st.none() | st.sampled_from([Reason.WRONG_ROAD, Reason.TOO_SLOW, Reason.SENSOR_FAULT]))
    def answer(self, reason: Reason | None) -> None:
        for name in sorted(self.asked):
            self.asked.discard(name)
            if reason is None:
                self.left_s[name] = self.time_s
            self.take(self.surroundings.answer(name, reason, self.moment, left_at_s=self.time_s))

    @rule(name=NAMES)
    def get_no_map(self, name: str) -> None:
        self.take(self.surroundings.no_map(name, self.moment))

    @invariant()
    def memory_is_bounded(self) -> None:
        assert len(self.surroundings.passes) <= PASSES_LIMIT_COUNT
        assert self.surroundings.known_count <= LINES_LIMIT_COUNT

    @invariant()
    def what_is_open_is_what_was_opened(self) -> None:
        assert {one.section_id for one in self.surroundings.passes} == self.open

    def teardown(self) -> None:
        for _ in range(2):
            for name in sorted(self.asked):
                self.asked.discard(name)
                self.take(self.surroundings.answer(name, Reason.WRONG_ROAD, self.moment))
            self.take(self.surroundings.finish(self.moment))
        for name in sorted(self.asked):
            self.asked.discard(name)
            self.take(self.surroundings.answer(name, Reason.WRONG_ROAD, self.moment))
        assert not self.open


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(max_examples=40, stateful_step_count=40, deadline=None)
