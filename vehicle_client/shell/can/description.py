"""A DBC and a signal mapping as the layouts of the frames that hold our channels."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cantools

from roadgrip.errors import ConfigurationError
from vehicle_client.recording.bit_fields import BitField
from vehicle_client.recording.frames import FrameLayout, FrameSignal
from vehicle_client.recording.mapping_draft import DescribedSignal
from vehicle_client.recording.signal_mapping import ALL_BITS_SET, checked_against, meant, signal_mapping_of_toml

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from vehicle_client.recording.signal_mapping import SignalMapping, SignalSource, Word

_PGN_MASK = 0x3FFFF00
_PGN_MASK_ADDRESSED = 0x3FF0000
"""A parameter group whose format byte is below 240 names the receiver in its lower byte."""


@dataclass(frozen=True, slots=True)
class FrameKey:
    """What tells the frames of one message from others on the same bus.

    Attributes:
        frame_id: Identifier, or the parameter group within it.
        extended: Whether it has 29 bits.
    """

    frame_id: int
    extended: bool


@dataclass(frozen=True, slots=True)
class CanMapping:
    """A signal mapping with what its DBC says about it.

    Attributes:
        mapping: What `signals.toml` says.
        layouts: By frame, then by the bus that the mapping asks for; "" is any bus.
    """

    mapping: SignalMapping
    layouts: Mapping[FrameKey, Mapping[str, FrameLayout]]

    def key_of(self, frame_id: int, *, extended: bool) -> FrameKey:
        """Return what a frame is found by."""
        return FrameKey(_parameter_group(frame_id) if self.mapping.j1939 and extended else frame_id, extended)

    def layouts_of(self, frame_id: int, *, extended: bool, bus: str) -> tuple[FrameLayout, ...]:
        """Return what is to be read from a frame; nothing from one that is not mapped."""
        found = self.layouts.get(self.key_of(frame_id, extended=extended))
        if found is None:
            return ()
        return tuple(layout for wanted, layout in found.items() if wanted in {"", bus})

    @property
    def frame_ids(self) -> tuple[tuple[int, bool], ...]:
        """Identifiers for the filter of an adapter; empty if a filter of identifiers cannot say it (J1939)."""
        return () if self.mapping.j1939 else tuple((key.frame_id, key.extended) for key in self.layouts)


def read_signals(path: Path) -> SignalMapping:
    """Return what a file `signals.toml` says.

    Raises:
        ConfigurationError: It cannot be read, or something in it is not allowed.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot read {path}: {error}") from error
    return signal_mapping_of_toml(text, place=str(path))


EXAMPLE = "example"
"""Names the packaged mapping of a made-up car, whose DBC the simulator's drives are written with."""


def path_of_signals(name: str) -> Path:
    """Return where a mapping is: a path, or the packaged one if it is called `example`."""
    return Path(str(files("vehicle_client.shell.can") / "example" / "signals.toml")) if name == EXAMPLE else Path(name)


def read_can_mapping(path: Path) -> CanMapping:
    """Return a signal mapping with what its DBC, which it finds beside it, says.

    Raises:
        ConfigurationError: One of the files cannot be read, or they do not fit each other; the message says where.
    """
    mapping = read_signals(path)
    if not mapping.dbc:
        raise ConfigurationError(f"{path}: says no dbc, which CAN frames need")
    return can_mapping_at(mapping, path)


def can_mapping_at(mapping: SignalMapping, path: Path) -> CanMapping:
    """Return a signal mapping that was read from a path with what its DBC, which lies beside it, says.

    Raises:
        ConfigurationError: The DBC cannot be read, or they do not fit each other; the message says where.
    """
    dbc = path.parent / mapping.dbc
    return can_mapping_of(mapping, _database_at(dbc, place=f"{path} dbc"), dbc=dbc.name)


def signals_of_dbc(path: Path) -> tuple[DescribedSignal, ...]:
    """Return what a DBC says of all its signals.

    Raises:
        ConfigurationError: It cannot be read.
    """
    return tuple(
        DescribedSignal(
            message=message.name,
            name=signal.name,
            unit=signal.unit or "",
            length_bits=signal.length,
            comment=signal.comment or "",
            choices=tuple(str(name) for name in (signal.choices or {}).values()),
        )
        for message in _database_at(path, place="--dbc").messages
        for signal in message.signals
    )


def _database_at(dbc: Path, *, place: str) -> Any:
    try:
        return cantools.database.load_file(dbc, strict=False)
    except OSError as error:
        raise ConfigurationError(f"{place}: cannot read {dbc}: {error.strerror or error}") from error
    except Exception as error:  # cantools raises what its parsers raise
        raise ConfigurationError(f"{place}: {dbc} cannot be understood: {error}") from error


def can_mapping_of(mapping: SignalMapping, database: Any, *, dbc: str) -> CanMapping:
    """Return a signal mapping with what a database of cantools says.

    Raises:
        ConfigurationError: The mapping names what the database does not know.
    """
    messages = {message.name: message for message in database.messages}
    checked_against(mapping, {name: [s.name for s in of.signals] for name, of in messages.items()}, dbc=dbc)
    wanted: dict[FrameKey, dict[str, list[FrameSignal]]] = {}
    described: dict[FrameKey, Any] = {}
    for source in mapping.sources:
        message = messages[source.message]
        frame_id = _parameter_group(message.frame_id) if mapping.j1939 else message.frame_id
        key = FrameKey(frame_id, bool(message.is_extended_frame))
        described[key] = message
        signals = {signal.name: signal for signal in message.signals}
        wanted.setdefault(key, {}).setdefault(source.bus, []).append(
            _frame_signal(source, signals, place=f"{mapping.place} [{source.table}]")
        )
    return CanMapping(
        mapping,
        {
            key: {
                bus: FrameLayout(
                    message=described[key].name,
                    frame_id=described[key].frame_id,
                    extended=key.extended,
                    bytes_count=described[key].length,
                    signals=tuple(signals),
                    bus=bus,
                )
                for bus, signals in by_bus.items()
            }
            for key, by_bus in wanted.items()
        },
    )


def bit_field_of(signal: Any) -> BitField:
    """Return where a signal of cantools is, and what it means."""
    return BitField(
        start_bit=signal.start,
        length_bits=signal.length,
        little_endian=signal.byte_order == "little_endian",
        signed=signal.is_signed,
        floating=signal.is_float,
        scale=float(signal.scale),
        zero_value=float(signal.offset),
    )


def _frame_signal(source: SignalSource, signals: Mapping[str, Any], *, place: str) -> FrameSignal:
    signal = signals[source.signal]
    bits = bit_field_of(signal)
    if ALL_BITS_SET in source.invalid and (bits.signed or bits.floating):
        raise ConfigurationError(
            f"{place} invalid: {source.signal} has a sign, so that {ALL_BITS_SET} is a common value; give the number"
        )
    conditions = {}
    for key, name, words in (
        ("valid_when", source.valid_signal, source.valid_values),
        ("negative_when", source.sign_signal, source.negative_values),
    ):
        other = signals.get(name)
        conditions[key] = () if other is None else ((bit_field_of(other), _raws(words, other, place=f"{place} {key}")),)
    return FrameSignal(
        source=source,
        bits=bits,
        present=tuple(_selectors(signal, signals)),
        valid=conditions["valid_when"],
        negative=conditions["negative_when"],
        invalid_raws=_raws(source.invalid, signal, place=f"{place} invalid"),
        active_raws=_raws(source.active, signal, place=f"{place} active") if source.active else None,
    )


def _selectors(signal: Any, signals: Mapping[str, Any]) -> Iterable[tuple[BitField, frozenset[int]]]:
    while signal.multiplexer_ids and signal.multiplexer_signal:
        selector = signals[signal.multiplexer_signal]
        yield bit_field_of(selector), frozenset(signal.multiplexer_ids)
        signal = selector


def _raws(words: Iterable[Word], signal: Any, *, place: str) -> frozenset[int]:
    bits = bit_field_of(signal)
    names = {str(name): int(number) for number, name in (signal.choices or {}).items()}
    raws = set()
    for word in words:
        if word == ALL_BITS_SET:
            raws.add(bits.all_bits_set)
        elif isinstance(word, str):
            if word not in names:
                known = f"; it knows {', '.join(names)}" if names else "; it names no values"
                raise ConfigurationError(f"{place}: {signal.name} has no value {word!r}{meant(word, names)}{known}")
            raws.add(names[word] & bits.all_bits_set)
        else:
            raws.add(bits.raw_of_value(word))
    return frozenset(raws)


def _parameter_group(frame_id: int) -> int:
    return frame_id & (_PGN_MASK if (frame_id >> 16) & 0xFF >= 0xF0 else _PGN_MASK_ADDRESSED)
