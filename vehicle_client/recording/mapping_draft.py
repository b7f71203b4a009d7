"""A first draft of `signals.toml` by the names of a DBC: the likeliest signal of each channel, the next as comments.

Names and units only say what something is called; whether it is that, `vehicle_client.recording.inspection` says.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from vehicle_client.recording.channels import STABILITY_CHANNELS
from vehicle_client.recording.signal_mapping import OPTIONAL_CHANNELS, TABLES

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

OTHERS_COUNT = 4
"""So many more candidates are listed."""


@dataclass(frozen=True, slots=True)
class DescribedSignal:
    """What a DBC says about a signal.

    Attributes:
        message: It comes in.
        name: Of the signal.
        unit: As the DBC writes it.
        length_bits: Of its raw number.
        comment: For people.
        choices: Names of raw numbers.
    """

    message: str
    name: str
    unit: str = ""
    length_bits: int = 16
    comment: str = ""
    choices: tuple[str, ...] = ()


_UNITS = {
    "m/s2": r"m/s(\^|\*\*)?2|m/s²|m/s/s|mps2|m/ss|m_s2|meterperseconsquar\w*",
    "g": r"g|forceofgravi\w*",
    "deg/s": r"(°|deg|degs|grad|degree|degrees)(/s|/sec|ps|persec)|degreofarcpersecon\w*",
    "rad/s": r"rad(/s|/sec|ps)",
    "deg": r"°|deg|grad|degree|degrees|degreofarc\w*",
    "rad": r"rad",
    "km/h": r"km/h|kmh|kph|km/hr|km/hour|kilometerperhour\w*",
    "mph": r"mph|mi/h",
    "m/s": r"m/s|m/sec|mps|meterpersecon\w*",
    "rpm": r"rpm|1/min|u/min|/min|r/min",
    "m": r"m|meter",
}
_LEFT, _RIGHT = r"(left|li|links|l|lh|lft)", r"(right|re|rechts|r|rh|rt|rgt)"
_FRONT, _REAR = r"(front|frnt|fr|frt|vorn\w*|v|f)", r"(rear|rr|hint\w*|h|back|r)"
_WHEEL = r"(wheel|whl|wspd|rad|raddrehz\w*|radgeschw\w*|ws|wss|roue|speed|spd|vel|geschw\w*)"


def _corner(ends: str, sides: str, letters: str) -> tuple[str, ...]:
    return (rf"\b{_WHEEL}\b", rf"\b({letters})\b|\b{ends}\b.*\b{sides}\b|\b{sides}\b.*\b{ends}\b")


_FLAG = (r"\b(act|active|actv|aktiv|akt|intervention|eingriff|ctrl|control|cntrl|event|inprogress|regel\w*)\b",)
_NAMES: dict[str, tuple[str, ...]] = {
    "accel_x": (
        r"\b(acc|accel|acceleration|beschl\w*|a|ax|g|sensor)\b",
        r"\b(long|lon|longitudinal|laengs\w*|lgt|x|ax|fwd|forward)\b",
    ),
    "accel_y": (
        r"\b(acc|accel|acceleration|beschl\w*|a|ay|g|sensor|quer\w*)\b",
        r"\b(lat|lateral|quer\w*|y|ay|trans|left|right)\b",
    ),
    "roll_rate": (r"\b(roll|wank\w*)\b", r"\b(rate|rt|geschw\w*|vel|speed|roll)\b"),
    "yaw_rate": (r"\b(yaw|yawrate|gier\w*|psip|psi)\b",),
    "steer": (r"\b(ste|stee\w*|strg|lenk\w*|lw|lws|lwi|swa|sas|stw|volant|pinion)\b",),
    "wheel_front_left": _corner(_FRONT, _LEFT, "fl|lf|vl|fahrerv"),
    "wheel_front_right": _corner(_FRONT, _RIGHT, "fr|rf|vr"),
    "wheel_rear_left": _corner(_REAR, _LEFT, "rl|lr|hl|bl"),
    "wheel_rear_right": _corner(_REAR, _RIGHT, "rr|hr|br"),
    "abs": (r"\babs\b", *_FLAG),
    "tcs": (r"\b(tcs|asr|tc|trac|traction)\b", *_FLAG),
    "esc": (r"\b(esc|esp|vsc|vdc|dsc|fdr|vsa|dstc)\b", *_FLAG),
    "latitude": (r"\b(latitude|lat|breite\w*)\b", r"\b(gps|gnss|nav|pos|position|latitude|breite\w*)\b"),
    "longitude": (r"\b(longitude|lon|long|lng|laenge\w*)\b", r"\b(gps|gnss|nav|pos|position|longitude|laenge\w*)\b"),
    "gnss_accuracy": (r"\b(gps|gnss|nav|pos|position)\b", r"\b(acc|hacc|accuracy|error|epe)\b"),
    "gnss_speed": (r"\b(gps|gnss|nav|sog|ground)\b", r"\b(speed|spd|vel|velocity|sog|geschw\w*)\b"),
}
"""Words of message and signal that all must be there; the signal's own count twice."""
_SAID_BY_UNIT = {"m/s2": "acceleration", "g": "acceleration"}
_UNLIKELY = re.compile(
    r"\b(offset|bias|min|max|status|stat|valid|validity|qf|q|state|crc|counter|cnt|temp|target|tgt|req|rq|request|desired|soll"
    r"|getriebe|id|ident\w*|init|autohold|hba|hdc|epb|verz"
    r"|des|limit|torque|moment|trq|tq|sign|vz|vorz\w*|pump|lamp|fault|err|dir|direction|ref|raw)\b"
)
_RATES = re.compile(r"\b(rate|speed|spd|vel|geschw\w*|velocity)\b")


def mapping_draft(signals: Iterable[DescribedSignal], *, dbc: str) -> tuple[str, tuple[str, ...]]:
    """Return a text for `signals.toml`, and the channels that a car needs and nothing looked like.

    Args:
        signals: All of the DBC.
        dbc: Path of the DBC beside the file.
    """
    known = tuple(signals)
    lines = (
        f"# A draft by names and units of {dbc}. Look at every table, then let `roadgrip-vehicle inspect` judge it.",
        "# Every key is explained in docs/can-logs.md.",
        f"dbc = {json.dumps(dbc)}",
        'vehicle = "vehicle.toml"',
    )
    blocks = ["\n".join(lines)]
    missing = []
    for table in _NAMES:
        found = candidates(known, table)
        if found:
            blocks.append(_block(table, found, known))
        elif _is_needed(table):
            missing.append(table)
            blocks.append(f"# Nothing looks like it; say where it is.\n#[{table}]\n#message = \n#signal = \n#unit = ")
    return "\n\n".join(blocks) + "\n", tuple(missing)


def candidates(signals: Iterable[DescribedSignal], table: str) -> list[DescribedSignal]:
    """Return the signals whose name and unit suit a table of `signals.toml`, the likeliest first."""
    scored = [(score, -i, signal) for i, signal in enumerate(signals) if (score := _score(signal, table)) > 0]
    return [signal for _, _, signal in sorted(scored, key=lambda one: one[:2], reverse=True)]


def unit_of(text: str) -> str:
    """Return what `signals.toml` calls a DBC's unit; empty if it knows no such."""
    plain = re.sub(r"^unit_|[\s\[\]()]", "", text.strip().lower())
    return next((unit for unit, pattern in _UNITS.items() if re.fullmatch(pattern, plain)), "")


def _is_needed(table: str) -> bool:
    channel = TABLES[table][0]
    return table in list(TABLES)[:9] and channel not in OPTIONAL_CHANNELS


def _words(text: str) -> str:
    """Return the words of a name in small letters, between blanks: `WheelSpd_FL` is `wheel spd fl`."""
    parted = re.sub(r"([a-z])([A-Z])|([A-Z])([A-Z][a-z])", r"\1\3 \2\4", text)
    return re.sub(r"[^a-z]+", " ", parted.lower())


def _score(signal: DescribedSignal, table: str) -> int:
    unit = unit_of(signal.unit)
    own = _words(signal.name)
    whole = " ".join((own, _words(signal.message), _words(signal.comment), _SAID_BY_UNIT.get(unit, "")))
    if not all(re.search(pattern, whole) for pattern in _NAMES[table]):
        return 0
    hits = sum(bool(re.search(pattern, own)) for pattern in _NAMES[table])
    if not hits or _UNLIKELY.search(own):
        return 0
    channel, units = TABLES[table]
    if channel in STABILITY_CHANNELS:
        return 2 * hits if signal.length_bits <= 2 else 0
    if signal.unit.strip() and unit not in units:
        return 0
    if table == "steer" and _RATES.search(own):
        return 0
    # A signal of few bits is a state or a number of something, whatever it is called.
    return 0 if signal.length_bits < 8 else 2 * hits + 3 * bool(unit)


def _block(table: str, found: Sequence[DescribedSignal], signals: Iterable[DescribedSignal]) -> str:
    best = found[0]
    channel, units = TABLES[table]
    lines = [f"# or {of.message}.{of.name}{_in(of)}" for of in found[1 : 1 + OTHERS_COUNT]]
    lines += [f"[{table}]", f"message = {json.dumps(best.message)}", f"signal = {json.dumps(best.name)}"]
    if channel not in STABILITY_CHANNELS:
        unit = unit_of(best.unit)
        said = f'unit = "{unit}"' if unit else f"unit = {json.dumps(next(iter(units)))}  # the DBC says none; guessed"
        lines.append(said)
    if table == "steer":
        lines.append("#steering_ratio = 15  # if it is the steering wheel's angle; inspect tells about how much")
    lines += [
        f"# beside it: {of.name}{_in(of)}; perhaps for valid_when or negative_when"
        for of in signals
        if of.message == best.message and of is not best and _belongs(of, best)
    ]
    return "\n".join(lines)


def _in(signal: DescribedSignal) -> str:
    said = signal.unit.strip() or ", ".join(signal.choices[:5])
    return f" ({said})" if said else ""


def _belongs(small: DescribedSignal, to: DescribedSignal) -> bool:
    """Return whether a short signal is named like a longer one: its state, or its sign."""
    words, others = _words(small.name).split(), _words(to.name).split()
    return small.length_bits <= 3 and bool(words) and bool(others) and words[0] == others[0]
