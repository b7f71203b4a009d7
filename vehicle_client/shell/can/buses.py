"""Open CAN buses: a car's adapter, or a virtual one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import can

from roadgrip.errors import ConfigurationError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from can import BusABC


def open_bus(
    interface: str, channel: str, *, bitrate_hz: int | None = None, frame_ids: Iterable[tuple[int, bool]] = ()
) -> BusABC:
    """Return a bus that whoever opened it shuts down; it is a context manager.

    Args:
        interface: What python-can calls the adapter: `socketcan`, `virtual`, `pcan`, `vector`, ...
        channel: Of that adapter, such as `can0`.
        bitrate_hz: Bits a second, where the adapter is to set it; socketcan has it set already.
        frame_ids: The only frames to let through, each with whether its identifier is an extended one; all if empty.

    Raises:
        ConfigurationError: There is no such adapter, or it cannot be opened.
    """
    filters = [{"can_id": i, "can_mask": 0x1FFFFFFF if wide else 0x7FF, "extended": wide} for i, wide in frame_ids]
    options: dict[str, Any] = {} if bitrate_hz is None else {"bitrate": bitrate_hz}
    try:
        return can.Bus(channel=channel, interface=interface, can_filters=filters or None, **options)
    except (can.CanError, OSError, ValueError, ImportError, NotImplementedError) as error:
        raise ConfigurationError(f"cannot open CAN {interface} {channel}: {error}") from error


def send_frame(bus: BusABC, frame_id: int, data: bytes, *, extended: bool = False) -> bool:
    """Return whether a frame could be handed to the bus; a bus that is full or off is no error of ours."""
    try:
        bus.send(can.Message(arbitration_id=frame_id, data=data, is_extended_id=extended))
    except can.CanError:
        return False
    return True
