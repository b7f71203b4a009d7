"""Vehicles hear a unit, drive by what it says, and tell it what they found: the circle that a unit lives in.

What drivers are told depends on what was estimated, and what is estimated depends on how they drive. Whatever follows
from that shows here and nowhere else: an advice that confirms itself, obedient drivers who are so slow that they tell
nothing, a unit that nobody counts for any more.

Units apply the very rules of the road side unit; vehicles and models are the caller's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from math import nan
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import numpy as np

from roadgrip.features import NEWEST_TABLE
from roadgrip.records import Advisory, FrictionInterval, NotCounted
from training.advice_following import draw_obedience_ratio, obedient
from training.loop_unit import LoopUnit, UnitRules

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from roadgrip.units import BoolArray, FloatArray
    from rsu_app.domain.judgement import Judgement
    from vehicle_client.simulator.plan import PassagePlan

_SLOWEST_PLACE = NEWEST_TABLE.index("speed_min_mps")
_PROFILE_PLACES = NEWEST_TABLE.columns([name for name in NEWEST_TABLE.names if name.startswith("grip_profile_")])
SLOT_S = 300.0
"""Vehicles that arrive within so long all hear what the unit said at its beginning: as long as an advice is valid."""


@dataclass(frozen=True, slots=True)
class Traveller:
    """A vehicle that comes to the road.

    Attributes:
        at_s: When.
        plan: How it drives when its driver is told nothing.
        reluctance_frac: The driver follows the advice where the compliance is above this; between 0 and 1.
        obedience_ratio: His speed over the advised one, if he follows.
    """

    at_s: float
    plan: PassagePlan
    reluctance_frac: float
    obedience_ratio: float


@dataclass(frozen=True, slots=True)
class Passed:
    """What became of a vehicle.

    Attributes:
        row: Its features with those of the road, of the newest table; None where it gave no summary. (columns,)
        kept_to_road: Whether it came out at the other end.
        duration_s: Time from arriving to leaving the section.
        label_mu: What friction it found.
        mean_speed_mps: Inside the section.
        peak_utilisation_ratio: Largest share of the grip that it used.
    """

    row: FloatArray | None
    kept_to_road: bool
    duration_s: float
    label_mu: float
    mean_speed_mps: float
    peak_utilisation_ratio: float


Drive: TypeAlias = Callable[[Sequence["PassagePlan"]], Sequence[Passed]]
"""Drives some plans, in their order."""
Judge: TypeAlias = Callable[["FloatArray"], Sequence["Judgement"]]
"""What rows of features say about friction, in their order: (n, columns) in, n out."""


@dataclass(frozen=True, slots=True)
class Case:
    """One unit and those who hear it.

    Attributes:
        name: One of its kind among those that are run side by side.
        judge: The unit's model.
        rules: The unit's rules.
        compliance_frac: Share of the drivers who follow the advice.
        told_ratio: Speed that drivers are told over the one the unit means: other than 1, the advice is wrong on
            purpose.
    """

    name: str
    judge: Judge
    rules: UnitRules
    compliance_frac: float
    told_ratio: float = 1.0


_TRUTHS = ("follows", "kept_to_road", "passed", "at_least", "said_at_least")


@dataclass(frozen=True, slots=True)
class Course:
    """How a case went; `(n,)` by vehicle in the order of their coming, `(m,)` by everything that the unit said.

    Attributes:
        at_s: When each vehicle came. (n,)
        base_friction_mu: What the road offered a new tyre then. (n,)
        told_mps: What its driver was told. (n,)
        follows: Whether he followed. (n,)
        kept_to_road: Whether it came out at the other end. (n,)
        passed: Whether it gave a summary. (n,)
        flags: Why it does not count, as a number; see `roadgrip.records.NotCounted`. (n,)
        mu: Its estimate; NaN without. (n,)
        at_least: Whether the estimate is taken for a lower bound. (n,)
        label_mu: What friction it found. (n,)
        mean_speed_mps: Inside the section. (n,)
        peak_utilisation_ratio: Largest share of the grip that it used. (n,)
        said_at_s: When the unit said something. (m,)
        said_mu_new: Upper end of the interval that advice rests on; NaN without an interval. (m,)
        said_median_mu: Median of the estimates that counted; NaN without. (m,)
        said_count: Vehicles behind it. (m,)
        said_at_least: Whether it is marked as hardly more than a lower bound. (m,)
        advised_mps: What the unit advised, before anybody made it wrong. (m,)
    """

    at_s: FloatArray
    base_friction_mu: FloatArray
    told_mps: FloatArray
    follows: BoolArray
    kept_to_road: BoolArray
    passed: BoolArray
    flags: FloatArray
    mu: FloatArray
    at_least: BoolArray
    label_mu: FloatArray
    mean_speed_mps: FloatArray
    peak_utilisation_ratio: FloatArray
    said_at_s: FloatArray
    said_mu_new: FloatArray
    said_median_mu: FloatArray
    said_count: FloatArray
    said_at_least: BoolArray
    advised_mps: FloatArray

    @property
    def counted(self) -> BoolArray:
        """Which vehicles count in the window. (n,)"""
        return self.passed & (self.flags == NotCounted.NONE.value)

    def arrays(self) -> dict[str, FloatArray]:
        """Return everything by name, as numbers."""
        return {field.name: np.asarray(getattr(self, field.name), dtype=np.float64) for field in fields(self)}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, FloatArray]) -> Self:
        """Return the course whose `arrays` these are."""
        typed: dict[str, Any] = {n: values != 0.0 if n in _TRUTHS else values for n, values in arrays.items()}
        return cls(**typed)


def draw_travellers(
    rng: np.random.Generator,
    *,
    until_s: float,
    vehicles_per_hour: float,
    plan_at: Callable[[np.random.Generator, float], PassagePlan],
) -> tuple[Traveller, ...]:
    """Return vehicles that come by chance, so many in the hour.

    Args:
        rng: Source of chance.
        until_s: None comes later.
        vehicles_per_hour: Their number is this times the hours.
        plan_at: How one drives that comes at a given time and is told nothing.
    """
    times_s = np.sort(rng.uniform(0.0, until_s, round(vehicles_per_hour * until_s / 3600.0)))
    return tuple(
        Traveller(
            at_s=at_s,
            plan=plan_at(rng, at_s),
            reluctance_frac=rng.random(),
            obedience_ratio=draw_obedience_ratio(rng),
        )
        for at_s in times_s.tolist()
    )


def heard(traveller: Traveller, *, section: RoadSection, told_mps: float, compliance_frac: float) -> PassagePlan:
    """Return how a vehicle drives whose driver is told a speed.

    Args:
        traveller: The vehicle.
        section: The road.
        told_mps: The speed.
        compliance_frac: Share of the drivers who follow.
    """
    if traveller.reluctance_frac >= compliance_frac:
        return traveller.plan
    return obedient(traveller.plan, told_mps=traveller.obedience_ratio * told_mps, section=section)


def closed_loop(
    cases: Sequence[Case],
    travellers: Sequence[Traveller],
    *,
    section: RoadSection,
    drive: Drive,
) -> dict[str, Course]:
    """Return how each case goes, by name.

    The same vehicles come to all of them, each with a unit of its own. Those who drive alike are driven once.

    Args:
        cases: Units and their hearers.
        travellers: Vehicles, in the order of their coming.
        section: The road.
        drive: Drives them.
    """
    circles = [_Circle(case, section) for case in cases]
    slots_count = int(max((a.at_s for a in travellers), default=0.0) // SLOT_S) + 1
    for slot in range(slots_count):
        begin_s = slot * SLOT_S
        coming = [traveller for traveller in travellers if begin_s <= traveller.at_s < begin_s + SLOT_S]
        plans = [circle.plans(coming, now_s=begin_s) for circle in circles]
        distinct = list(dict.fromkeys(plan for of_case in plans for plan in of_case))
        passed = dict(zip(distinct, drive(distinct), strict=True))
        for circle, of_case in zip(circles, plans, strict=True):
            circle.take(coming, [passed[plan] for plan in of_case])
    for circle in circles:
        circle.listen(until_s=slots_count * SLOT_S)
    return {circle.case.name: circle.course() for circle in circles}


class _Circle:
    """A case under way."""

    def __init__(self, case: Case, section: RoadSection) -> None:
        self.case = case
        self._section = section
        self._unit = LoopUnit(section, case.rules)
        self._told_mps = nan
        self._on_the_road: list[tuple[float, int, Judgement, FloatArray]] = []
        self._vehicles: list[tuple[float, ...]] = []
        self._said: list[tuple[float, ...]] = []

    def plans(self, coming: Sequence[Traveller], *, now_s: float) -> list[PassagePlan]:
        """Return how vehicles drive that hear what the unit says now."""
        self._told_mps = self.case.told_ratio * self.listen(until_s=now_s).speed_mps
        compliance_frac = self.case.compliance_frac
        return [
            heard(one, section=self._section, told_mps=self._told_mps, compliance_frac=compliance_frac)
            for one in coming
        ]

    def take(self, coming: Sequence[Traveller], passed: Sequence[Passed]) -> None:
        """Judge what became of those vehicles; the unit hears of each when it leaves the section."""
        telling = [i for i, one in enumerate(passed) if one.row is not None]
        rows = [one.row for one in passed if one.row is not None]
        judged = dict(zip(telling, self.case.judge(np.array(rows)), strict=True)) if rows else {}
        for i, (traveller, one) in enumerate(zip(coming, passed, strict=True)):
            said = judged.get(i)
            self._vehicles.append(self._vehicle(traveller, one, said))
            if said is not None and one.row is not None:
                self._on_the_road.append((traveller.at_s + one.duration_s, len(self._vehicles), said, one.row))

    def listen(self, *, until_s: float) -> Advisory:
        """Let the unit hear of all that left the section by now, and return what it says then."""
        self._on_the_road.sort(key=lambda leaving: leaving[:2])
        while self._on_the_road and self._on_the_road[0][0] <= until_s:
            left_at_s, _, said, row = self._on_the_road.pop(0)
            counts = self._unit.hear(
                said,
                left_at_s=left_at_s,
                profile_ratio=row[_PROFILE_PLACES],
                slowest_mps=float(row[_SLOWEST_PLACE]),
            )
            if counts:
                self._note(left_at_s)
        return self._note(until_s)

    def course(self) -> Course:
        """Return how it went."""
        names = [field.name for field in fields(Course)]
        columns = [*np.array(self._vehicles).reshape(-1, 12).T, *np.array(self._said).reshape(-1, 6).T]
        return Course.of_arrays(dict(zip(names, columns, strict=True)))

    def _note(self, now_s: float) -> Advisory:
        advisory = self._unit.advise(now_s=now_s)
        interval: FrictionInterval | None = advisory.interval
        published = (nan, nan, 0.0, 0.0)
        if interval is not None:
            counts = float(interval.passages_count), float(self._unit.at_least)
            published = (interval.mu_new, interval.median_mu, *counts)
        self._said.append((now_s, *published, advisory.speed_mps))
        return advisory

    def _vehicle(self, traveller: Traveller, passed: Passed, said: Judgement | None) -> tuple[float, ...]:
        return (
            traveller.at_s,
            traveller.plan.base_friction_mu,
            self._told_mps,
            float(traveller.reluctance_frac < self.case.compliance_frac),
            float(passed.kept_to_road),
            float(said is not None),
            0.0 if said is None else float(said.flags.value),
            nan if said is None or said.mu is None else said.mu,
            float(said is not None and said.at_least),
            passed.label_mu,
            passed.mean_speed_mps,
            passed.peak_utilisation_ratio,
        )
