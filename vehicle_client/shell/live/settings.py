"""What somebody who runs the live client may choose."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from vehicle_client.shell.keys import Keys
from vehicle_client.shell.live.units import BEACON_AGE_LIMIT_S
from vehicle_client.shell.spool import CAPACITY_COUNT
from vehicle_client.vehicle_profile import PAPER_VEHICLE, VehicleProfile

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from vehicle_client.shell.uplink import UnitAddress

BEACON_PORT = 4741
"""Where units send their beacons by default."""
COUNTERS_PERIOD_S = 600.0


@dataclass(frozen=True, slots=True)
class LiveSettings:
    """One client's settings.

    Attributes:
        spool_folder: Where summaries wait for a unit.
        vehicle: The own car.
        keys: What is signed with, and who is believed.
        unit: A unit or server that is there without beacons: `udp`, or `http` and `https` over cellular.
        beacons: Where beacons arrive, host and port; None listens for none.
        beacon_age_limit_s: A beacon issued longer ago, or later, than this is refused; infinite believes all.
        dashboard: Path of a Unix socket or local host and port for those who show advice; None for nobody.
        sections: Maps that are known from the start; without positions their beacons count as heard all the time.
        missing: Sensors that this car does not have: they read zero.
        spool_capacity_count: Summaries that wait at most.
        counters_period_s: How often the counters are logged.
        once: Whether the client ends with its recording.
        memory_file: Where the car keeps what it learns of itself; None learns nothing.
    """

    spool_folder: Path
    vehicle: VehicleProfile = PAPER_VEHICLE
    keys: Keys = field(default_factory=Keys)
    unit: UnitAddress | None = None
    beacons: tuple[str, int] | None = None
    beacon_age_limit_s: float = BEACON_AGE_LIMIT_S
    dashboard: Path | tuple[str, int] | None = None
    sections: tuple[RoadSection, ...] = ()
    missing: tuple[str, ...] = ()
    spool_capacity_count: int = CAPACITY_COUNT
    counters_period_s: float = COUNTERS_PERIOD_S
    once: bool = False
    memory_file: Path | None = None
