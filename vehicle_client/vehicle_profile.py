"""What a vehicle knows of itself, as one record and as a file that an integrator writes once per model of car.

name = "Volvo XC90 2015"

[geometry]            # `VehicleGeometry`: wheelbase, track and front axle must be said, the rest is zero if not
wheelbase_m = 2.984
track_m = 1.670
front_axle_m = 1.43

[observer]            # `ObserverParameters`: those of the XC90 where nothing is said
rear_slip_gradient_s2pm = 0.0075
lowpass = "hamming_fir"  # or "butterworth"

[handling]            # `Handling`: that of the XC90 where nothing is said, grown or shrunk to the mass
mass_kg = 2100.0

[handling.tyre]       # `TyreCurve`: likewise
stiffness_ratio = 14.99

[noise]               # `GripNoise`: that of a production car's sensors where nothing is said
steer_rad = 0.0006

[memory]              # for a car that learns what it is like
handling_std_ratio = 0.1  # how well [handling] is known
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from dataclasses import MISSING, dataclass, fields, replace
from typing import Any, TypeVar

from roadgrip.errors import ConfigurationError
from vehicle_client.estimation.filters import LowPass
from vehicle_client.estimation.grip.noise import AUTOMOTIVE_NOISE, GripNoise
from vehicle_client.estimation.handling import XC90_HANDLING, Handling, TyreCurve
from vehicle_client.estimation.mounting import mounting_rotation
from vehicle_client.estimation.observer import XC90_PARAMETERS, ObserverParameters
from vehicle_client.estimation.vehicle_geometry import XC90, VehicleGeometry

_Record = TypeVar("_Record", VehicleGeometry, ObserverParameters, Handling, TyreCurve, GripNoise)
_DIVIDES = {"roll_crossover_hz", "mass_kg", "yaw_inertia_kgm2"}
_ZERO_IS_FINE = {"relaxation_m", "rolling_resistance_ratio", "level_gain_ratio"}
_SHARES = {"front_drive_frac", "front_brake_frac", "level_gain_ratio"}
HANDLING_STD_RATIO = 0.1
"""Of constants from a car's papers and the class of its tyres."""
_HANDLING_STD_RANGE = (1e-4, 0.5)
_COSINE_MIN_RATIO = 0.5
"""A sensor that lies on its side does not feel what is asked of it."""


@dataclass(frozen=True, slots=True)
class VehicleProfile:
    """A model of car, as the onboard client needs to know it.

    Attributes:
        name: What people call it.
        geometry: Where wheels and sensors sit.
        parameters: Constants of the estimation, which belong to a vehicle.
        handling: Masses, load shift and tyres, for the physical inverse.
        noise: How far the physical inverse trusts the sensors.
        handling_std_ratio: How well masses, springs and tyres are known, one standard deviation, for a car that learns.
    """

    name: str
    geometry: VehicleGeometry
    parameters: ObserverParameters = XC90_PARAMETERS
    handling: Handling = XC90_HANDLING
    noise: GripNoise = AUTOMOTIVE_NOISE
    handling_std_ratio: float = HANDLING_STD_RATIO


PAPER_VEHICLE = VehicleProfile(name="Volvo XC90 2015", geometry=XC90)
"""The car of the paper."""


def profile_of_toml(text: str, *, place: str) -> VehicleProfile:
    """Return the vehicle that a file describes.

    Args:
        text: What the file holds.
        place: What the file is called, for messages.

    Raises:
        ConfigurationError: It is no TOML, a key is unknown or missing, a value is no finite number or no known
            filter, a length, a share or a constant cannot be, or the inertial sensor lies on its side.
    """
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also a number of 5,000 digits, and a thousand brackets
        raise ConfigurationError(f"{place} is no TOML: {error}") from error
    unknown = sorted(set(table) - {"name", "geometry", "observer", "handling", "noise", "memory"})
    if unknown:
        raise ConfigurationError(
            f"{place}: unknown {', '.join(unknown)}; a vehicle has name, [geometry], [observer], [handling], [noise], "
            "[memory]"
        )
    name = table.get("name", place)
    if not isinstance(name, str):
        raise ConfigurationError(f"{place}: name is {name!r}, not a text")
    profile = VehicleProfile(
        name=name,
        geometry=_record_of(VehicleGeometry, table.get("geometry", {}), place=f"{place} [geometry]"),
        parameters=_record_of(ObserverParameters, table.get("observer", {}), place=f"{place} [observer]"),
        handling=_handling_of(table.get("handling", {}), place=f"{place} [handling]"),
        noise=_record_of(GripNoise, table.get("noise", {}), place=f"{place} [noise]"),
        handling_std_ratio=_handling_std_ratio(table.get("memory", {}), place=f"{place} [memory]"),
    )
    _check(profile, place=place)
    return profile


def scaled_to(mass_kg: float) -> Handling:
    """Return the handling of the XC90 grown or shrunk to a mass: a car of which no more is known.

    Forces, loads and inertia go with the mass, so that slip per acceleration stays. A larger car is no larger here.

    Args:
        mass_kg: Positive.
    """
    ratio = mass_kg / XC90_HANDLING.mass_kg
    return replace(
        XC90_HANDLING,
        mass_kg=mass_kg,
        yaw_inertia_kgm2=XC90_HANDLING.yaw_inertia_kgm2 * ratio,
        drag_kgpm=XC90_HANDLING.drag_kgpm * ratio,
        steer_compliance_radpn=XC90_HANDLING.steer_compliance_radpn / ratio,
        tyre=replace(XC90_HANDLING.tyre, nominal_load_n=XC90_HANDLING.tyre.nominal_load_n * ratio),
    )


def toml_of_profile(profile: VehicleProfile) -> str:
    """Return the file that `profile_of_toml` reads back as the same vehicle."""
    # Texts of JSON are texts of TOML, but for the one sign that only TOML wants escaped.
    lines = [f"name = {json.dumps(profile.name, ensure_ascii=False)}".replace("\x7f", "\\u007f")]
    records = (
        ("geometry", profile.geometry),
        ("observer", profile.parameters),
        ("handling", profile.handling),
        ("handling.tyre", profile.handling.tyre),
        ("noise", profile.noise),
    )
    for title, record in records:
        lines += ["", f"[{title}]"]
        values = {field.name: getattr(record, field.name) for field in fields(record)}
        lines += [f"{key} = {_written(value)}" for key, value in values.items() if not isinstance(value, TyreCurve)]
    lines += ["", "[memory]", f"handling_std_ratio = {profile.handling_std_ratio!r}"]
    return "\n".join(lines) + "\n"


def vehicle_digest(profile: VehicleProfile) -> str:
    """Return sixteen hexadecimal characters that change with everything that is declared of a car but its name."""
    return hashlib.sha256(toml_of_profile(replace(profile, name="")).encode()).hexdigest()[:16]


def _check(profile: VehicleProfile, *, place: str) -> None:
    geometry = profile.geometry
    if not (0.0 < geometry.front_axle_m < geometry.wheelbase_m and geometry.track_m > 0.0):
        raise ConfigurationError(f"{place}: the front axle must lie within the wheelbase, and the track be positive")
    upright = abs(mounting_rotation(geometry).diagonal())
    if upright.min() < _COSINE_MIN_RATIO:
        raise ConfigurationError(f"{place}: the inertial sensor lies on its side; exchange its axes in the mapping")
    for record in (profile.parameters, profile.handling, profile.handling.tyre, profile.noise):
        for field in fields(record):
            value = getattr(record, field.name)
            if not isinstance(value, float):
                continue
            always = isinstance(record, TyreCurve | GripNoise) and field.name not in _ZERO_IS_FINE
            divides = always or field.name.startswith("sigma_") or field.name in _DIVIDES
            if value < 0.0 or (divides and value == 0.0):
                raise ConfigurationError(
                    f"{place}: {field.name} is {value}, but must be {'' if divides else 'zero or '}positive"
                )
            if field.name in _SHARES and value > 1.0:
                raise ConfigurationError(f"{place}: {field.name} is {value}, but is a share: at most 1")


def _handling_std_ratio(table: object, *, place: str) -> float:
    if not isinstance(table, dict):
        raise ConfigurationError(f"{place} is {table!r}, not a table")
    unknown = sorted(set(table) - {"handling_std_ratio"})
    if unknown:
        raise ConfigurationError(f"{place}: unknown {', '.join(unknown)}; it may hold handling_std_ratio")
    ratio = float(_read("handling_std_ratio", table.get("handling_std_ratio", HANDLING_STD_RATIO), place=place))
    least, most = _HANDLING_STD_RANGE
    if not least <= ratio <= most:
        raise ConfigurationError(f"{place}: handling_std_ratio is {ratio}, not from {least} to {most}")
    return ratio


def _handling_of(table: object, *, place: str) -> Handling:
    if not isinstance(table, dict):
        raise ConfigurationError(f"{place} is {table!r}, not a table")
    mass_kg = _read("mass_kg", table.get("mass_kg", XC90_HANDLING.mass_kg), place=place)
    if mass_kg <= 0.0:
        raise ConfigurationError(f"{place}: mass_kg is {mass_kg}, but must be positive")
    start = scaled_to(mass_kg)
    said = {name: value for name, value in table.items() if name != "tyre"}
    tyre = _record_of(TyreCurve, table.get("tyre", {}), place=f"{place} tyre", start=start.tyre)
    return replace(_record_of(Handling, said, place=place, start=start), tyre=tyre)


def _record_of(kind: type[_Record], table: object, *, place: str, start: _Record | None = None) -> _Record:
    if not isinstance(table, dict):
        raise ConfigurationError(f"{place} is {table!r}, not a table")
    known = {field.name: field for field in fields(kind) if field.name != "tyre"}
    unknown = sorted(set(table) - set(known))
    if unknown:
        raise ConfigurationError(f"{place}: unknown {', '.join(unknown)}; it may hold {', '.join(sorted(known))}")
    said = {name: _read(name, value, place=place) for name, value in table.items()}
    if start is not None:
        return replace(start, **said)
    missing = sorted(name for name, field in known.items() if field.default is MISSING and name not in table)
    if missing:
        raise ConfigurationError(f"{place}: {', '.join(missing)} must be said")
    return kind(**said)


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
