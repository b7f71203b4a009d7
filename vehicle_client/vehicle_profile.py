"""What a vehicle knows of itself, as one record and as a file that an integrator writes once per model of car.

name = "Volvo XC90 2015"

[geometry]            # `VehicleGeometry`: wheelbase, track and front axle must be said, the rest is zero if not
wheelbase_m = 2.984
track_m = 1.670
front_axle_m = 1.43

[observer]            # `ObserverParameters`: those of the XC90 where nothing is said
rear_slip_gradient_s2pm = 0.0075
lowpass = "hamming_fir"  # or "butterworth"
"""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import MISSING, dataclass, fields
from typing import Any, TypeVar

from roadgrip.errors import ConfigurationError
from vehicle_client.estimation.filters import LowPass
from vehicle_client.estimation.mounting import mounting_rotation
from vehicle_client.estimation.observer import XC90_PARAMETERS, ObserverParameters
from vehicle_client.estimation.vehicle_geometry import XC90, VehicleGeometry

_Record = TypeVar("_Record", VehicleGeometry, ObserverParameters)
_COSINE_MIN_RATIO = 0.5
"""A sensor that lies on its side does not feel what is asked of it."""


@dataclass(frozen=True, slots=True)
class VehicleProfile:
    """A model of car, as the onboard client needs to know it.

    Attributes:
        name: What people call it.
        geometry: Where wheels and sensors sit.
        parameters: Constants of the estimation, which belong to a vehicle.
    """

    name: str
    geometry: VehicleGeometry
    parameters: ObserverParameters = XC90_PARAMETERS


PAPER_VEHICLE = VehicleProfile(name="Volvo XC90 2015", geometry=XC90)
"""The car of the paper."""


def profile_of_toml(text: str, *, place: str) -> VehicleProfile:
    """Return the vehicle that a file describes.

    Args:
        text: What the file holds.
        place: What the file is called, for messages.

    Raises:
        ConfigurationError: It is no TOML, a key is unknown or missing, a value is no finite number or no known
            filter, a length or a constant cannot be, or the inertial sensor lies on its side.
    """
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"{place} is no TOML: {error}") from error
    unknown = sorted(set(table) - {"name", "geometry", "observer"})
    if unknown:
        raise ConfigurationError(f"{place}: unknown {', '.join(unknown)}; a vehicle has name, [geometry], [observer]")
    name = table.get("name", place)
    if not isinstance(name, str):
        raise ConfigurationError(f"{place}: name is {name!r}, not a text")
    profile = VehicleProfile(
        name=name,
        geometry=_record_of(VehicleGeometry, table.get("geometry", {}), place=f"{place} [geometry]"),
        parameters=_record_of(ObserverParameters, table.get("observer", {}), place=f"{place} [observer]"),
    )
    geometry = profile.geometry
    if not (0.0 < geometry.front_axle_m < geometry.wheelbase_m and geometry.track_m > 0.0):
        raise ConfigurationError(f"{place}: the front axle must lie within the wheelbase, and the track be positive")
    upright = abs(mounting_rotation(geometry).diagonal())
    if upright.min() < _COSINE_MIN_RATIO:
        raise ConfigurationError(f"{place}: the inertial sensor lies on its side; exchange its axes in the mapping")
    for field in fields(ObserverParameters):
        value = getattr(profile.parameters, field.name)
        divides = field.name.startswith("sigma_") or field.name == "roll_crossover_hz"
        if field.name != "lowpass" and (value < 0.0 or (divides and value == 0.0)):
            raise ConfigurationError(
                f"{place}: {field.name} is {value}, but must be {'' if divides else 'zero or '}positive"
            )
    return profile


def toml_of_profile(profile: VehicleProfile) -> str:
    """Return the file that `profile_of_toml` reads back as the same vehicle."""
    # Texts of JSON are texts of TOML, but for the one sign that only TOML wants escaped.
    lines = [f"name = {json.dumps(profile.name, ensure_ascii=False)}".replace("\x7f", "\\u007f")]
    for title, record in (("geometry", profile.geometry), ("observer", profile.parameters)):
        lines += ["", f"[{title}]"]
        lines += [f"{field.name} = {_written(getattr(record, field.name))}" for field in fields(record)]
    return "\n".join(lines) + "\n"


def _record_of(kind: type[_Record], table: object, *, place: str) -> _Record:
    if not isinstance(table, dict):
        raise ConfigurationError(f"{place} is {table!r}, not a table")
    names = {field.name for field in fields(kind)}
    unknown = sorted(set(table) - names)
    if unknown:
        raise ConfigurationError(f"{place}: unknown {', '.join(unknown)}; it may hold {', '.join(sorted(names))}")
    missing = sorted(field.name for field in fields(kind) if field.default is MISSING and field.name not in table)
    if missing:
        raise ConfigurationError(f"{place}: {', '.join(missing)} must be said")
    return kind(**{name: _read(name, value, place=place) for name, value in table.items()})


def _read(name: str, value: object, *, place: str) -> Any:
    if name == "lowpass":
        if not isinstance(value, str) or value not in set(LowPass):
            raise ConfigurationError(f"{place}: {name} is {value!r}, not one of {', '.join(LowPass)}")
        return LowPass(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigurationError(f"{place}: {name} is {value!r}, not a finite number")
    return float(value)


def _written(value: float | LowPass) -> str:
    return f'"{value}"' if isinstance(value, LowPass) else repr(float(value))
