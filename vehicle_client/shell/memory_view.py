"""What a car has learned of itself, in plain words and as JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from vehicle_client.estimation.grip.memory import CONSTANTS, Constant, handling_with

if TYPE_CHECKING:
    from rich.table import Table

    from vehicle_client.estimation.handling import Handling
    from vehicle_client.shell.car_memory import KeptMemory
    from vehicle_client.vehicle_profile import VehicleProfile

WORDS = {
    "steer_offset_rad": "steering shows too much to the left",
    "yaw_rate_scale_ratio": "gyro reads too much",
    "accel_y_offset_mps2": "lateral accelerometer shows too much to the left",
    "accel_y_scale_ratio": "lateral accelerometer reads too much",
    "accel_x_offset_mps2": "forward accelerometer shows too much forward",
    "front_radius_ratio": "front wheels seem to turn faster than rear ones",
    "stiffness_log_ratio": "stiffness of the tyres, sideways",
    "peak_slip_log_ratio": "slip at which the tyres grip most",
    "along_stiffness_log_ratio": "stiffness of the tyres, lengthwise",
    "yaw_inertia_log_ratio": "yaw inertia",
    "compliance_log_ratio": "how far the front wheels give way",
    "front_drive_log_ratio": "share of the drive on the front axle",
}
"""Each constant of a memory, as a person would say it."""
_MRAD = 1000.0


def memory_to_json(kept: KeptMemory, vehicle: VehicleProfile | None) -> dict[str, Any]:
    """Return a memory as JSON shows it.

    Args:
        kept: What the file holds.
        vehicle: Whose memory it is, if that is known: then declared constants stand beside learned ones.
    """
    memory = kept.memory
    constants: dict[str, dict[str, Any]] = {
        constant.name: {"value": value, "std": memory.std(constant.name), "declared_std": first}
        for constant, value, first in zip(CONSTANTS, memory.mean, memory.first_std, strict=True)
    }
    if vehicle is not None:
        known = handling_with(vehicle.handling, memory)
        for constant in CONSTANTS:
            constants[constant.name]["handling"] = {
                name: {"declared": _declared(vehicle.handling, name), "learned": _declared(known, name)}
                for name in constant.handling
            }
    return {
        "vehicle": kept.vehicle_name,
        "vehicle_digest": kept.vehicle_digest,
        "passages_count": memory.passages_count,
        "constants": constants,
    }


def memory_table(kept: KeptMemory, vehicle: VehicleProfile | None) -> Table:
    """Return a memory as a table for a person.

    Args:
        kept: What the file holds.
        vehicle: Whose memory it is, if that is known.
    """
    from rich.table import Table

    memory = kept.memory
    title = f"{kept.vehicle_name}; passages learned from: {memory.passages_count}"
    table = Table("what", "declared", "learned", title=title, title_justify="left")
    for constant, value, first in zip(CONSTANTS, memory.mean, memory.first_std, strict=True):
        table.add_row(
            WORDS[constant.name],
            _declared_text(constant, first, vehicle),
            _learned_text(constant, value, memory.std(constant.name), vehicle, kept),
        )
    return table


def _declared_text(constant: Constant, std: float, vehicle: VehicleProfile | None) -> str:
    if not constant.handling:
        return f"0 ± {_amount(constant.name, std)}"
    if vehicle is None:
        return f"as in its file ± {100.0 * std:.1f} %"
    return f"{_numbers(constant, vehicle.handling)} ± {100.0 * std:.1f} %"


def _learned_text(
    constant: Constant, value: float, std: float, vehicle: VehicleProfile | None, kept: KeptMemory
) -> str:
    if not constant.handling:
        return f"{_amount(constant.name, value, sign='+')} ± {_amount(constant.name, std)}"
    change = f"{100.0 * (math.exp(value) - 1.0):+.1f} % ± {100.0 * std:.1f} %"
    if vehicle is None:
        return change
    return f"{_numbers(constant, handling_with(vehicle.handling, kept.memory))} ({change})"


def _numbers(constant: Constant, handling: Handling) -> str:
    return ", ".join(f"{_declared(handling, name):.4g}" for name in constant.handling)


def _declared(handling: Handling, name: str) -> float:
    of_tyre = name.removeprefix("tyre.")
    value: float = getattr(handling, name) if of_tyre == name else getattr(handling.tyre, of_tyre)
    return value


def _amount(name: str, value: float, *, sign: str = "") -> str:
    if name.endswith("_rad"):
        return f"{_MRAD * value:{sign}.2f} mrad"
    if name.endswith("_mps2"):
        return f"{value:{sign}.3f} m/s2"
    return f"{100.0 * value:{sign}.2f} %"
