"""Which signals of somebody else's car mean what: the file `signals.toml`.

One table per channel says where it comes from and in which unit. From CAN, by the names of a DBC::

    dbc = "car.dbc"  # beside this file
    vehicle = "vehicle.toml"  # optional: the car, see `vehicle_client.vehicle_profile`

    [yaw_rate]
    message = "ESP_02"
    signal = "YawRate"
    unit = "deg/s"

    [steer]
    message = "LWI_01"
    signal = "SteeringWheelAngle"
    unit = "deg"
    steering_ratio = 15.8

or, from CSV and Parquet, by the names of columns, with `time_column` in place of `dbc`. The whole list of keys is in
docs/vehicle.md.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from roadgrip.errors import ConfigurationError
from vehicle_client.recording.channels import CHANNELS, STABILITY_CHANNELS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from roadgrip.units import FloatArray

Word: TypeAlias = float | str
"""A value of a signal: a number as the DBC scales it, or a name the DBC gives to a raw number."""

ALL_BITS_SET = "all-bits-set"
"""Says in `invalid` that a signal with every bit set is not there."""

_DEG = math.pi / 180.0
_ANGLE = {"rad": 1.0, "deg": _DEG}
_RATE = {"rad/s": 1.0, "deg/s": _DEG}
_ACCELERATION = {"m/s2": 1.0, "g": 9.80665}
_SPEED = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
_ROTATION = {"rad/s": 1.0, "rpm": 2.0 * math.pi / 60.0}
"""Of a wheel, in radians a second; the rolling radius makes it a speed."""

TABLES = {
    "accel_x": ("accel_x_mps2", _ACCELERATION),
    "accel_y": ("accel_y_mps2", _ACCELERATION),
    "roll_rate": ("roll_rate_radps", _RATE),
    "yaw_rate": ("yaw_rate_radps", _RATE),
    "steer": ("steer_rad", _ANGLE),
    "wheel_front_left": ("wheel_front_left_mps", _SPEED | _ROTATION),
    "wheel_front_right": ("wheel_front_right_mps", _SPEED | _ROTATION),
    "wheel_rear_left": ("wheel_rear_left_mps", _SPEED | _ROTATION),
    "wheel_rear_right": ("wheel_rear_right_mps", _SPEED | _ROTATION),
    "abs": ("abs_active", {"": 1.0}),
    "tcs": ("tcs_active", {"": 1.0}),
    "esc": ("esc_active", {"": 1.0}),
    "stability": ("stability_active", {"": 1.0}),
    "latitude": ("lat_deg", {"deg": 1.0, "rad": 1.0 / _DEG}),
    "longitude": ("lon_deg", {"deg": 1.0, "rad": 1.0 / _DEG}),
    "gnss_accuracy": ("gnss_accuracy_m", {"m": 1.0}),
    "gnss_speed": ("gnss_speed_mps", _SPEED),
}
"""What a table of the file may be called: its channel, and the units it may come in."""
OPTIONAL_CHANNELS = ("roll_rate_radps",)
"""Of the sensors, those that a car may lack; they read zero, and the reader says so."""

_FILE_KEYS = ("dbc", "time_column", "vehicle", "bus", "j1939", "rolling_radius_m", *TABLES)
_SOURCE_KEYS = ("message", "signal", "column", "unit", "gain", "offset", "delay_s", "bus", "invalid", "valid_when")
_SIGNED_KEYS = ("negative_when",)
_STEER_KEYS = ("steering_ratio", "steering_table_deg")


@dataclass(frozen=True, slots=True)
class SignalSource:
    """Where one channel comes from, and how its numbers become ours: (value * gain + zero), then the steering table.

    The value is what the DBC makes of the bits, less than zero where another signal is its sign and says so.

    Attributes:
        table: Name of the table that says so.
        channel: One of `SERIES_CHANNELS` of `vehicle_client.recording.channels`.
        message: Of the DBC; empty for a column.
        signal: Of that message, or the name of a column.
        gain: Our unit per theirs, sign and steering ratio included.
        zero_value: Ours where theirs is zero.
        delay_s: How old a value is when its frame is stamped.
        bus: Name or number of the bus in the log; any if empty.
        invalid: Values that mean there is none.
        valid_signal: Signal of the same message that says whether this one holds; none if empty.
        valid_values: What it then says.
        sign_signal: Signal of the same message that is this one's sign; none if empty.
        negative_values: What it says where this one is below zero.
        active: Values of a flag that mean yes; any but zero if empty.
        steering_table_rad: Steering wheel and front wheels, pairs from right to left; none if empty.
    """

    table: str
    channel: str
    message: str
    signal: str
    gain: float = 1.0
    zero_value: float = 0.0
    delay_s: float = 0.0
    bus: str = ""
    invalid: tuple[Word, ...] = ()
    valid_signal: str = ""
    valid_values: tuple[Word, ...] = ()
    sign_signal: str = ""
    negative_values: tuple[Word, ...] = ()
    active: tuple[Word, ...] = ()
    steering_table_rad: tuple[tuple[float, float], ...] = ()

    def converted(self, values: FloatArray) -> FloatArray:
        """Return their values in our unit; NaN stays NaN. (n,)"""
        ours = values * self.gain + self.zero_value
        if self.steering_table_rad:
            wheel, road = np.array(self.steering_table_rad).T
            ours = np.interp(ours, wheel, road)
        return ours

    def inverted(self, values: FloatArray) -> FloatArray:
        """Return our values as theirs. (n,)"""
        theirs = values
        if self.steering_table_rad:
            wheel, road = np.array(self.steering_table_rad).T
            theirs = np.interp(theirs, road, wheel)
        return (theirs - self.zero_value) / self.gain


@dataclass(frozen=True, slots=True)
class SignalMapping:
    """What `signals.toml` says.

    Attributes:
        sources: One per channel.
        dbc: Path of the DBC, relative to the file; empty if the recording is a table.
        time_column: Column of seconds, if the recording is a table.
        vehicle: Path of the vehicle's file, relative to the file; empty if it says none.
        j1939: Whether frames are told by their parameter group alone, whoever sends them and how urgently.
        place: What the file is called, for messages.
    """

    sources: tuple[SignalSource, ...]
    dbc: str = ""
    time_column: str = ""
    vehicle: str = ""
    j1939: bool = False
    place: str = field(default="signals.toml", compare=False)

    @property
    def missing(self) -> tuple[str, ...]:
        """The sensors that the file leaves out."""
        given = {source.channel for source in self.sources}
        return tuple(name for name in CHANNELS if name not in given)


def signal_mapping_of_toml(text: str, *, place: str) -> SignalMapping:
    """Return what a file `signals.toml` says.

    Args:
        text: What the file holds.
        place: What the file is called, for messages.

    Raises:
        ConfigurationError: It is no TOML, or a key or value is not one of those allowed; the message names file, table
            and key, says what is allowed, and what was perhaps meant.
    """
    try:
        file = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also a number of 5,000 digits, and a thousand brackets
        raise ConfigurationError(f"{place} is no TOML: {error}") from error
    _check_keys(file, _FILE_KEYS, place=place)
    for key, kind in (("dbc", str), ("time_column", str), ("vehicle", str), ("j1939", bool)):
        if not isinstance(file.get(key, kind()), kind):
            raise ConfigurationError(f"{place}: {key} must be {'text' if kind is str else 'true or false'}")
    if ("dbc" in file) == ("time_column" in file):
        raise ConfigurationError(f"{place}: either dbc (a CAN log) or time_column (a table) must be said, not both")
    mapping = SignalMapping(
        sources=tuple(_source(name, file, place=place) for name in TABLES if name in file),
        dbc=file.get("dbc", ""),
        time_column=file.get("time_column", ""),
        vehicle=file.get("vehicle", ""),
        j1939=file.get("j1939", False),
        place=place,
    )
    absent = [name for name, (channel, _) in TABLES.items() if channel in mapping.missing]
    needed = [name for name in absent if TABLES[name][0] not in OPTIONAL_CHANNELS]
    if needed:
        raise ConfigurationError(
            f"{place}: no [{'], ['.join(needed)}]; only [roll_rate] may be left out of the sensors"
        )
    if ("latitude" in file) != ("longitude" in file):
        raise ConfigurationError(f"{place}: [latitude] and [longitude] go together")
    return mapping


def checked_against(mapping: SignalMapping, signals_of: Mapping[str, Iterable[str]], *, dbc: str) -> SignalMapping:
    """Return the mapping if every message and signal it names is one of a DBC's.

    Args:
        mapping: With a DBC.
        signals_of: The DBC's signals by message.
        dbc: What the DBC is called, for messages.

    Raises:
        ConfigurationError: A name is unknown; the message says the nearest ones.
    """
    for source in mapping.sources:
        place = f"{mapping.place} [{source.table}]"
        if source.message not in signals_of:
            homes = [message for message, signals in signals_of.items() if source.signal in signals]
            home = f"; {source.signal!r} is in {' and '.join(repr(name) for name in homes[:3])}" if homes else ""
            raise ConfigurationError(
                f"{place} message: {dbc} has no {source.message!r}{meant(source.message, signals_of)}{home}"
            )
        signals = list(signals_of[source.message])
        for key, name in (
            ("signal", source.signal),
            ("valid_when", source.valid_signal),
            ("negative_when", source.sign_signal),
        ):
            if name and name not in signals:
                elsewhere = _elsewhere(name, source.message, signals_of) if key == "signal" else ""
                raise ConfigurationError(
                    f"{place} {key}: {source.message} of {dbc} has no {name!r}{meant(name, signals)}{elsewhere}"
                )
    return mapping


def meant(word: str, known: Iterable[str]) -> str:
    """Return what a wrong word was perhaps meant to be, as the end of a sentence; empty if nothing is near.

    Capitals do not count.
    """
    by_small = {name.casefold(): name for name in known}
    near = [by_small[name] for name in get_close_matches(word.casefold(), by_small, n=3, cutoff=0.5)]
    return f"; did you mean {' or '.join(near)}?" if near else ""


def _elsewhere(signal: str, message: str, signals_of: Mapping[str, Iterable[str]]) -> str:
    homes = [name for name, signals in signals_of.items() if name != message and signal in signals]
    return f"; message {' and '.join(homes[:3])} has one" if homes else ""


def _check_keys(table: Mapping[str, Any], known: tuple[str, ...], *, place: str) -> None:
    for key in table:
        if key not in known:
            raise ConfigurationError(f"{place}: unknown {key}{meant(key, known)}; allowed are {', '.join(known)}")


def _source(name: str, file: Mapping[str, Any], *, place: str) -> SignalSource:
    channel, units = TABLES[name]
    table, place = file[name], f"{place} [{name}]"
    if not isinstance(table, Mapping):
        raise ConfigurationError(f"{place} must be a table")
    is_flag = channel in STABILITY_CHANNELS
    keys = (*_SOURCE_KEYS, *(_STEER_KEYS if name == "steer" else ()), *(("active",) if is_flag else _SIGNED_KEYS))
    _check_keys(table, keys, place=place)
    needed = ("column",) if "time_column" in file else ("message", "signal")
    for key in (*needed, *(() if is_flag else ("unit",))):
        if not isinstance(table.get(key), str):
            allowed = f"one of {', '.join(units)}" if key == "unit" else "a name"
            raise ConfigurationError(f"{place}: {key} must be said, {allowed}")
    for key in {"message", "signal", "column"} - set(needed):
        if key in table:
            raise ConfigurationError(f"{place}: {key} means nothing here; it is found by {' and '.join(needed)}")
    factor, table_rad = _factor(name, table, file, place=place)
    gain = _number(table, "gain", 1.0, place=place)
    if gain == 0.0:
        raise ConfigurationError(f"{place} gain: it must not be zero")
    valid_signal, valid_values = _condition(table, "valid_when", place=place)
    sign_signal, negative_values = _condition(table, "negative_when", place=place)
    return SignalSource(
        table=name,
        channel=channel,
        message=table.get("message", ""),
        signal=table[needed[-1]],
        gain=gain * factor,
        zero_value=_number(table, "offset", 0.0, place=place) * factor,
        delay_s=_number(table, "delay_s", 0.0, place=place),
        bus=str(table.get("bus", file.get("bus", ""))),
        invalid=_words(table, "invalid", place=place),
        valid_signal=valid_signal,
        valid_values=valid_values,
        sign_signal=sign_signal,
        negative_values=negative_values,
        active=_words(table, "active", place=place),
        steering_table_rad=table_rad,
    )


def _factor(
    name: str, table: Mapping[str, Any], file: Mapping[str, Any], *, place: str
) -> tuple[float, tuple[tuple[float, float], ...]]:
    """Return our unit per theirs, and the table of steering angles if there is one."""
    channel, units = TABLES[name]
    unit = table.get("unit", "")
    if unit not in units:
        raise ConfigurationError(f"{place} unit: {unit!r} is not one of {', '.join(units)}{meant(unit, units)}")
    factor = units[unit]
    if channel.startswith("wheel") and unit in _ROTATION:
        if "rolling_radius_m" not in file:
            raise ConfigurationError(f"{place} unit: {unit} needs rolling_radius_m at the top of the file")
        factor *= _positive(file, "rolling_radius_m", place=place)
    if "steering_ratio" in table:
        if "steering_table_deg" in table:
            raise ConfigurationError(f"{place}: steering_ratio or steering_table_deg, not both")
        factor /= _positive(table, "steering_ratio", place=place)
    return factor, _steering_table(table.get("steering_table_deg", []), place=place)


def _steering_table(pairs: Any, *, place: str) -> tuple[tuple[float, float], ...]:
    if pairs == []:
        return ()
    try:
        table = [(float(wheel) * _DEG, float(road) * _DEG) for wheel, road in pairs]
    except (TypeError, ValueError):
        table = []
    rises = all(a[0] < b[0] and a[1] < b[1] for a, b in pairwise(table))
    if len(table) < 2 or not rises:
        raise ConfigurationError(
            f"{place}: steering_table_deg must be pairs [steering wheel, front wheels], both rising, such as "
            "[[-540, -33], [0, 0], [540, 33]]"
        )
    return tuple(table)


def _condition(table: Mapping[str, Any], key: str, *, place: str) -> tuple[str, tuple[Word, ...]]:
    """Return which other signal must say what; an empty name if none."""
    said = table.get(key)
    if said is None:
        return "", ()
    if not isinstance(said, Mapping) or set(said) != {"signal", "is"} or not isinstance(said["signal"], str):
        raise ConfigurationError(f'{place}: {key} must be like {{ signal = "YawRateState", is = [1] }}')
    words = _words(said, "is", place=place)
    if not words:
        raise ConfigurationError(f"{place} {key}: is must hold one value at least")
    return said["signal"], words


def _words(table: Mapping[str, Any], key: str, *, place: str) -> tuple[Word, ...]:
    said = table.get(key, [])
    words = said if isinstance(said, list) else [said]
    for word in words:
        if not isinstance(word, int | float | str):
            raise ConfigurationError(f"{place} {key}: {word!r} is neither a number nor a name of the DBC")
    return tuple(word if isinstance(word, str) else float(word) for word in words)


def _number(table: Mapping[str, Any], key: str, otherwise: float, *, place: str) -> float:
    number = table.get(key, otherwise)
    if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
        raise ConfigurationError(f"{place} {key}: {number!r} is no finite number")
    return float(number)


def _positive(table: Mapping[str, Any], key: str, *, place: str) -> float:
    number = _number(table, key, 0.0, place=place)
    if number <= 0.0:
        raise ConfigurationError(f"{place} {key}: {number!r} must be positive; turn an axis round with gain = -1")
    return number
