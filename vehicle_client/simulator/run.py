"""The door of the simulator: a section and a plan in, a drive out.

A drive depends on its section and its plan alone: one at a time or in batches, on any number of threads or processes,
it comes out the same to the last bit. The compiled part releases the interpreter's lock, so that callers may spread
plans over threads as well as over processes; this module starts neither.

The first call on a machine compiles for some tens of seconds; later processes read the compiler's cache.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from vehicle_client.simulator.drive import Drive, DriveOutcome, Truth
from vehicle_client.simulator.plan import (
    Driver,
    DriverKind,
    FrictionProfile,
    PassagePlan,
    SensorGrade,
    draw_driver,
    draw_plan,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roadgrip.section import RoadSection

__all__ = [
    "Drive",
    "DriveOutcome",
    "Driver",
    "DriverKind",
    "FrictionProfile",
    "PassagePlan",
    "SensorGrade",
    "Truth",
    "draw_driver",
    "draw_plan",
    "simulate_passage",
    "simulate_passages",
]


def simulate_passage(section: RoadSection, plan: PassagePlan) -> Drive:
    """Return one drive over a section, approach and exit included.

    A drive that leaves the road or spins is a value too: see `Drive.outcome`.

    Args:
        section: The road.
        plan: Everything else.

    Raises:
        SectionError: Position fixes are asked for, but the section has no anchors.
        ValueError: The plan is out of range.
    """
    raise NotImplementedError


def simulate_passages(section: RoadSection, plans: Sequence[PassagePlan]) -> list[Drive]:
    """Return the drives of many plans, in their order; each is what `simulate_passage` returns for it."""
    return [simulate_passage(section, plan) for plan in plans]
