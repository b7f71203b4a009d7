"""One simulated drive looked at closely: what was asked for, what was true, what the sensors made of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from roadgrip.errors import ConfigurationError
from roadgrip.records import Rejected
from roadgrip.units import GRAVITY_MPS2, PASCAL_PER_BAR, mps_to_kph
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.shell.fleet import simulator
from vehicle_client.shell.replay import made_to_json, refusal_text
from vehicle_client.shell.sources import write_trace
from vehicle_client.simulator.drive import DriveOutcome
from vehicle_client.simulator.plan import (
    DECLARED_NOISE,
    REFERENCE_PRESSURE_PA,
    DriverKind,
    FrictionProfile,
    PassagePlan,
    RoughnessClass,
    SensorGrade,
    StabilitySystems,
    draw_plan,
)

if TYPE_CHECKING:
    from pathlib import Path

    from rich.table import Table

    from roadgrip.section import RoadSection
    from roadgrip.units import BoolArray
    from vehicle_client.simulator.drive import Drive

CHANGEOVER_M = 20.0
"""Length over which one friction passes into the other, about the middle of the section."""


class StabilitySystem(StrEnum):
    """A stability system that can be switched off."""

    ABS = "abs"
    TCS = "tcs"
    ESC = "esc"


class Evenness(StrEnum):
    """How even the road is: a class of ISO 8608, or a plane."""

    SMOOTH = "smooth"
    A = "a"
    B = "b"
    C = "c"
    D = "d"
    E = "e"

    @property
    def roughness(self) -> RoughnessClass | None:
        """What a plan calls it."""
        return None if self is Evenness.SMOOTH else RoughnessClass(self.value)


@dataclass(frozen=True, slots=True)
class DriveOrder:
    """What a person asks of one drive; what he leaves open is drawn.

    Attributes:
        base_friction_mu: What the road offers a new tyre.
        second_friction_mu: The same from the middle of the section on, if it differs.
        kind: What the driver goes by.
        speed_mps: Speed he likes; drawn about the rated one if None.
        wear_factor: What wear leaves of the friction; drawn if None.
        pressure_pa: Of the tyres.
        evenness: Of the road.
        without: Stability systems that are switched off.
        grade: Which sensors the vehicle carries.
        seed: Of all that is drawn.
    """

    base_friction_mu: float = 0.35
    second_friction_mu: float | None = None
    kind: DriverKind = DriverKind.PRUDENT
    speed_mps: float | None = None
    wear_factor: float | None = None
    pressure_pa: float = REFERENCE_PRESSURE_PA
    evenness: Evenness = Evenness.A
    without: frozenset[StabilitySystem] = frozenset()
    grade: SensorGrade = SensorGrade.AUTOMOTIVE
    seed: int = 1


@dataclass(frozen=True, slots=True)
class SingleDrive:
    """A drive and what the onboard client made of it."""

    drive: Drive
    made: Summarised | Rejected


class Activity(NamedTuple):
    """What one stability system did in a drive.

    Attributes:
        system: Which.
        on: Whether it was switched on.
        active_frac: Share of the samples inside the section with it at work.
        active: At every sample.
    """

    system: StabilitySystem
    on: bool
    active_frac: float
    active: BoolArray

    @property
    def text(self) -> str:
        """How much it worked, for a person."""
        if not self.on:
            return "off"
        # A single intervention shall not read as none.
        return f"{self.active_frac:.1%}" if 0.0 < self.active_frac < 0.01 else f"{self.active_frac:.0%}"


def activities_of(drive: Drive) -> tuple[Activity, ...]:
    """Return what ABS, traction control and ESC did, in this order."""
    on, truth = drive.plan.stability, drive.truth
    return (
        Activity(StabilitySystem.ABS, on.abs_on, drive.abs_active_frac, truth.abs_active),
        Activity(StabilitySystem.TCS, on.tcs_on, drive.tcs_active_frac, truth.tcs_active),
        Activity(StabilitySystem.ESC, on.esc_on, drive.esc_active_frac, truth.esc_active),
    )


def plan_of(section: RoadSection, order: DriveOrder) -> PassagePlan:
    """Return the plan that an order means.

    What is ordered replaces what is drawn and leaves the other draws as they are, so that two orders with one seed
    differ in what they say alone.
    """
    drawn = draw_plan(
        np.random.default_rng(order.seed),
        section=section,
        base_friction_mu=order.base_friction_mu,
        grade=order.grade,
        kind=order.kind,
        friction_profile=_two_frictions(section, order),
        with_gnss=bool(section.anchors),
    )
    return replace(
        drawn,
        wear_factor=drawn.wear_factor if order.wear_factor is None else order.wear_factor,
        target_speed_mps=drawn.target_speed_mps if order.speed_mps is None else order.speed_mps,
        pressure_pa=order.pressure_pa,
        roughness=order.evenness.roughness,
        stability=StabilitySystems(
            abs_on=StabilitySystem.ABS not in order.without,
            tcs_on=StabilitySystem.TCS not in order.without,
            esc_on=StabilitySystem.ESC not in order.without,
        ),
    )


def _two_frictions(section: RoadSection, order: DriveOrder) -> FrictionProfile | None:
    if order.second_friction_mu is None:
        return None
    middle_m = 0.5 * section.length_m
    mu = np.array([order.base_friction_mu, order.second_friction_mu])
    return FrictionProfile(
        station_m=np.array([middle_m - 0.5 * CHANGEOVER_M, middle_m + 0.5 * CHANGEOVER_M]), left_mu=mu, right_mu=mu
    )


def drive_once(section: RoadSection, order: DriveOrder) -> SingleDrive:
    """Return one drive, fixed by its order, and its summary.

    Raises:
        ConfigurationError: The simulator is not installed, or it cannot drive what was ordered.
    """
    simulate_passage = simulator()
    try:
        drive = simulate_passage(section, plan_of(section, order))
    except ValueError as error:
        raise ConfigurationError(str(error)) from error
    return SingleDrive(drive, summarise_passage(drive.trace, section, noise=DECLARED_NOISE[order.grade]))


def outcome_text(driven: SingleDrive) -> str:
    """Return how the drive ended, for a person."""
    drive = driven.drive
    words = {
        DriveOutcome.COMPLETED: "completed",
        DriveOutcome.LEFT_ROAD: "left the road",
        DriveOutcome.SPUN: "spun",
        DriveOutcome.STOPPED: "stopped",
        DriveOutcome.TIMED_OUT: "took too long",
    }[drive.outcome]
    return words if drive.completed else f"{words} at {drive.truth.station_m[-1]:.0f} m"


def sideslip_error_rad(driven: SingleDrive) -> float | None:
    """Return the root mean square error of the estimated sideslip inside the section; None without an estimate."""
    if isinstance(driven.made, Rejected):
        return None
    inside = driven.made.match.inside(driven.drive.trace.time_s)
    error = driven.made.signals.sideslip_rad - driven.drive.truth.sideslip_rad
    return float(np.sqrt(np.mean(error[inside] ** 2)))


def single_drive_to_json(driven: SingleDrive) -> dict[str, Any]:
    """Return the drive as JSON shows it."""
    drive = driven.drive
    plan, truth = drive.plan, drive.truth
    guess_mu = plan.driver.friction_guess_mu
    return {
        "outcome": drive.outcome.value,
        "ended_at_m": float(truth.station_m[-1]),
        "duration_s": float(truth.time_s[-1]),
        "base_friction_mu": plan.base_friction_mu,
        "second_friction_mu": None if plan.friction_profile is None else float(plan.friction_profile.left_mu[-1]),
        "wear_factor": plan.wear_factor,
        "pressure_pa": plan.pressure_pa,
        "friction_mu": drive.label_mu,
        "lowest_friction_mu": drive.lowest_mu,
        "roughness_class": None if plan.roughness is None else plan.roughness.value,
        "driver_guess_mu": guess_mu if math.isfinite(guess_mu) else None,
        "target_speed_mps": plan.target_speed_mps,
        "slowest_mps": float(truth.velocity_x_mps.min()),
        "fastest_mps": float(truth.velocity_x_mps.max()),
        "peak_utilisation_ratio": drive.peak_utilisation_ratio,
        "peak_sideslip_rad": drive.peak_sideslip_rad,
        "peak_lateral_accel_mps2": float(np.abs(truth.accel_y_mps2).max()),
        "peak_lateral_offset_m": float(np.abs(truth.lateral_offset_m).max()),
        "least_wheel_load_n": float(truth.wheel_load_n.min()),
        "sensors": plan.sensor_grade.value,
        "abs_on": plan.stability.abs_on,
        "tcs_on": plan.stability.tcs_on,
        "esc_on": plan.stability.esc_on,
        "abs_active_frac": drive.abs_active_frac,
        "tcs_active_frac": drive.tcs_active_frac,
        "esc_active_frac": drive.esc_active_frac,
        "sideslip_error_rad": sideslip_error_rad(driven),
        "passage": made_to_json(driven.made),
    }


def single_drive_table(driven: SingleDrive, section: RoadSection) -> Table:
    """Return the drive as a table for a person."""
    from rich.table import Table

    drive, made = driven.drive, driven.made
    plan, truth = drive.plan, drive.truth
    speed = truth.velocity_x_mps
    table = Table("what", "value", title=f"One drive over {section.name}", title_justify="left", show_header=False)
    table.add_row("the drive", outcome_text(driven))
    table.add_row("friction of the road", f"{_road_friction_text(plan)} for a new tyre")
    table.add_row("tyres", f"wear factor {plan.wear_factor:.2f}, {plan.pressure_pa / PASCAL_PER_BAR:.1f} bar")
    table.add_row(
        "friction of these tyres", f"{drive.label_mu:.3f} over the worst 10 m, {drive.lowest_mu:.3f} at least"
    )
    table.add_row("surface", "smooth" if plan.roughness is None else f"ISO 8608 class {plan.roughness.upper()}")
    table.add_row("driver", _driver_text(plan))
    table.add_row("speed", f"{mps_to_kph(float(speed.min())):.0f} to {mps_to_kph(float(speed.max())):.0f} km/h")
    table.add_row("grip in use at most", f"{drive.peak_utilisation_ratio:.0%}")
    table.add_row("lateral acceleration at most", f"{float(np.abs(truth.accel_y_mps2).max()) / GRAVITY_MPS2:.2f} g")
    table.add_row("sideslip at most", f"{np.rad2deg(drive.peak_sideslip_rad):.1f} degrees")
    table.add_row("off the centre line at most", f"{float(np.abs(truth.lateral_offset_m).max()):.2f} m")
    table.add_row(
        "at work in the section",
        ", ".join(f"{a.system.upper()} {a.text}" for a in activities_of(drive)),
    )
    error_rad = sideslip_error_rad(driven)
    if isinstance(made, Rejected) or error_rad is None:
        table.add_row("summary", f"none: {refusal_text(made)}" if isinstance(made, Rejected) else "none")
    else:
        table.add_row("error of the estimated sideslip", f"{np.rad2deg(error_rad):.2f} degrees RMS")
        table.add_row("found by", f"{made.match.method.value}, confidence {made.match.confidence_frac:.2f}")
        table.add_row("summary", f"{len(made.summary.values)} numbers over {made.summary.duration_s:.1f} s")
    return table


def _road_friction_text(plan: PassagePlan) -> str:
    known = plan.friction_profile
    if known is None:
        return f"{plan.base_friction_mu:.2f}"
    return f"{known.left_mu[0]:.2f}, from {known.station_m.mean():.0f} m on {known.left_mu[-1]:.2f}"


def _driver_text(plan: PassagePlan) -> str:
    guess_mu = plan.driver.friction_guess_mu
    likes = "" if plan.target_speed_mps is None else f", likes {mps_to_kph(plan.target_speed_mps):.0f} km/h"
    if math.isfinite(guess_mu):
        return f"prudent, takes the road for {guess_mu:.2f}{likes}"
    return f"reacting, judges by what he feels{likes}"


def keep_trace(driven: SingleDrive, path: Path) -> None:
    """Write what the sensors saw, as `replay` reads it; the name says as what, see `write_trace`.

    Raises:
        ConfigurationError: The file cannot be written, or its name says nothing that can be.
        ModuleNotFoundError: .parquet and .mf4 need the extra `vehicle-files`.
    """
    try:
        write_trace(path, driven.drive.trace)
    except OSError as error:
        raise ConfigurationError(f"cannot write {path}: {error.strerror or error}") from error
