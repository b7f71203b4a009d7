"""Drives that take no simulator, and an uplink to a unit in the same process."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

import numpy as np

from roadgrip.records import KinematicSummary
from roadgrip.section import RoadSection
from tests.vehicle_client.shell.air import Unit
from vehicle_client.estimation.trace import Trace
from vehicle_client.simulator.drive import Drive, DriveOutcome, Truth
from vehicle_client.simulator.plan import PassagePlan


def a_trace(samples_count: int = 3000) -> Trace:
    flat = np.zeros(samples_count)
    return Trace(
        time_s=np.arange(samples_count) / 100.0,
        accel_x_mps2=flat,
        accel_y_mps2=flat,
        roll_rate_radps=flat,
        yaw_rate_radps=flat,
        steer_rad=flat,
        wheel_speed_mps=np.full((samples_count, 4), 15.0),
        valid=np.ones(samples_count, dtype=np.bool_),
    )


def a_drive(section: RoadSection, plan: PassagePlan, *, outcome: DriveOutcome = DriveOutcome.COMPLETED) -> Drive:
    trace = a_trace()
    flat, wheels = np.zeros(3000), np.zeros((3000, 4))
    truth = Truth(
        time_s=trace.time_s,
        station_m=flat,
        lateral_offset_m=flat,
        x_m=flat,
        y_m=flat,
        heading_rad=flat,
        velocity_x_mps=flat,
        velocity_y_mps=flat,
        sideslip_rad=flat,
        yaw_rate_radps=flat,
        roll_rad=flat,
        bank_rad=flat,
        accel_x_mps2=flat,
        accel_y_mps2=flat,
        steer_rad=flat,
        wheel_load_n=wheels,
        wheel_force_x_n=wheels,
        wheel_force_y_n=wheels,
        friction_mu=flat,
        utilisation_ratio=flat,
        abs_active=flat.astype(np.bool_),
        tcs_active=flat.astype(np.bool_),
        esc_active=flat.astype(np.bool_),
    )
    mu = plan.base_friction_mu * plan.wear_factor
    return Drive(
        plan=plan,
        outcome=outcome,
        trace=trace,
        truth=truth,
        label_mu=mu,
        lowest_mu=mu,
        abs_active_frac=0.0,
        tcs_active_frac=0.0,
        esc_active_frac=0.0,
        peak_utilisation_ratio=0.5,
        peak_sideslip_rad=0.02,
    )


@dataclass(frozen=True)
class Summarised:
    """What a pipeline made of a trace."""

    summary: KinematicSummary
    left_at_s: float


@dataclass
class WireToUnit:
    """One vehicle's uplink to a unit that answers at once, but for the messages that do not reach it."""

    unit: Unit
    lost: tuple[type, ...] = ()
    inbox: asyncio.Queue[bytes] = field(default_factory=asyncio.Queue)
    sent: list[bytes] = field(default_factory=list)
    closed: bool = False

    async def send(self, frame: bytes) -> None:
        self.sent.append(frame)
        _, _, message = self.unit.codec.ether.cargo.get(frame, (0, 0, None))
        if not isinstance(message, self.lost):
            for reply in self.unit.answer(frame, 0.0):
                self.inbox.put_nowait(reply)

    async def receive(self) -> bytes:
        return await self.inbox.get()

    async def close(self) -> None:
        self.closed = True
