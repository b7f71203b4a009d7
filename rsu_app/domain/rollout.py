"""Which bundle a unit runs, which it would go back to, and which it is trying out: a state, and what may become of it.

A release goes through three stages. In the shadow the candidate answers beside the live bundle and nobody hears it. On
probation it is live and the bundle before it answers beside it. Then it is settled, and the one before stays at hand::

    settled --installed--> shadow --switched--> probation --confirmed--> settled
       ^                     |                      |
       +------rejected-------+------rolled back-----+

Every arrow is one write of a small file; a unit that loses its power between two of them goes on from where it stood.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

FACTORY_ID = "factory"
"""Stands for the bundle that came with the software or that the settings name; it is not on the shelf."""


class Stage(StrEnum):
    """How far the newest release has come."""

    SETTLED = "settled"
    SHADOW = "shadow"
    PROBATION = "probation"


@dataclass(frozen=True, slots=True)
class ShelvedBundle:
    """A bundle on the shelf, as it was verified when it was put there.

    Attributes:
        bundle_id: Names it in every estimate; `FACTORY_ID` for the one that is not on the shelf.
        manifest_sha256: Of its manifest, which names all other files; empty for the factory's.
        sequence_number: Of the release that brought it; 0 for the factory's.
        ledger_hash: The laboratory's ledger entry about that release; empty for the factory's.
        gate: What the laboratory's gate said of it, "passed", "overridden" or "none".
    """

    bundle_id: str
    manifest_sha256: str
    sequence_number: int
    ledger_hash: str
    gate: str

    @property
    def from_factory(self) -> bool:
        """Whether it came with the software or is named by the settings."""
        return self.bundle_id == FACTORY_ID


FACTORY = ShelvedBundle(FACTORY_ID, "", 0, "", "none")


@dataclass(frozen=True, slots=True)
class RolloutState:
    """What a unit's shelf is for right now.

    Attributes:
        live: The bundle that vehicles are answered by.
        previous: The one before it, for a step back; None before the first switch and after a step back.
        candidate: The one in the shadow; given if and only if the stage is the shadow.
        stage: How far the newest release has come.
        newest_sequence_number: Highest release that was ever taken up; one at or below it is never taken again.
    """

    live: ShelvedBundle = FACTORY
    previous: ShelvedBundle | None = None
    candidate: ShelvedBundle | None = None
    stage: Stage = Stage.SETTLED
    newest_sequence_number: int = 0

    def __post_init__(self) -> None:
        problems = {
            "a candidate belongs into the shadow, and nothing else does": (self.candidate is None)
            == (self.stage is Stage.SHADOW),
            "probation needs a bundle to go back to": self.stage is Stage.PROBATION and self.previous is None,
            "a release is newer than the newest": any(
                each is not None and each.sequence_number > self.newest_sequence_number
                for each in (self.live, self.previous, self.candidate)
            ),
        }
        for problem, found in problems.items():
            if found:
                raise ValueError(problem)

    @property
    def needed_ids(self) -> frozenset[str]:
        """The bundles that must stay on the shelf."""
        held = (self.live, self.previous, self.candidate)
        return frozenset(each.bundle_id for each in held if each is not None and not each.from_factory)


def takes_up(state: RolloutState, sequence_number: int) -> bool:
    """Return whether a release is news: newer than every one before it."""
    return sequence_number > state.newest_sequence_number


def installed(state: RolloutState, candidate: ShelvedBundle) -> RolloutState:
    """Return the state after a release was put on the shelf: it goes into the shadow.

    One that is still in the shadow gives way to it. A live bundle on probation counts as confirmed by being left; a
    release of the bundle that is live already changes nothing but the number.

    Raises:
        ValueError: The release is no news.
    """
    if not takes_up(state, candidate.sequence_number):
        raise ValueError(f"release {candidate.sequence_number} is not newer than {state.newest_sequence_number}")
    newest = candidate.sequence_number
    if candidate.bundle_id == state.live.bundle_id:
        return replace(
            state, live=candidate, candidate=None, stage=_without_shadow(state), newest_sequence_number=newest
        )
    return replace(state, candidate=candidate, stage=Stage.SHADOW, newest_sequence_number=newest)


def switched(state: RolloutState) -> RolloutState:
    """Return the state after the candidate became live; it is on probation, and the one before stays at hand.

    Raises:
        ValueError: There is no candidate.
    """
    if state.candidate is None:
        raise ValueError("nothing is in the shadow")
    return replace(state, live=state.candidate, previous=state.live, candidate=None, stage=Stage.PROBATION)


def confirmed(state: RolloutState) -> RolloutState:
    """Return the state after the live bundle has stood its probation.

    Raises:
        ValueError: None is on probation.
    """
    if state.stage is not Stage.PROBATION:
        raise ValueError("nothing is on probation")
    return replace(state, stage=Stage.SETTLED)


def rejected(state: RolloutState) -> RolloutState:
    """Return the state after the candidate failed in the shadow: it is taken off, and its release never taken again.

    Raises:
        ValueError: There is no candidate.
    """
    if state.candidate is None:
        raise ValueError("nothing is in the shadow")
    return replace(state, candidate=None, stage=Stage.SETTLED)


def rolled_back(state: RolloutState) -> RolloutState:
    """Return the state after the step back: the bundle before is live again, and what was live is gone.

    A candidate in the shadow is dropped with it: it was held against what is no longer live.

    Raises:
        ValueError: There is nothing to go back to.
    """
    if state.previous is None:
        raise ValueError("there is no previous bundle to go back to")
    return replace(state, live=state.previous, previous=None, candidate=None, stage=Stage.SETTLED)


def _without_shadow(state: RolloutState) -> Stage:
    return Stage.SETTLED if state.stage is Stage.SHADOW else state.stage
