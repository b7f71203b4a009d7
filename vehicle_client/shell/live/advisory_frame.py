"""Advice as a CAN frame, for instrument clusters that read no sockets; `advisory.dbc` beside this file describes it."""

from __future__ import annotations

from importlib.resources import files
from typing import TYPE_CHECKING, Any

import cantools

from roadgrip.records import Confidence
from roadgrip.units import mps_to_kph
from vehicle_client.shell.can.buses import send_frame

if TYPE_CHECKING:
    from can import BusABC

    from vehicle_client.shell.live.dashboard import ShownAdvice

MESSAGE_NAME = "RoadgripAdvisory"
NONE_VALUE = 255
_CONFIDENCES = {Confidence.INSUFFICIENT: 1, Confidence.PROVISIONAL: 2, Confidence.RECOMMENDED: 3}
_POLYNOMIAL = 0x1D


class AdvisoryFrames:
    """Makes one frame after the other."""

    def __init__(self, *, frame_id: int | None = None) -> None:
        """Read the description.

        Args:
            frame_id: Identifier to send with, if the car's network has another one free.
        """
        text = files("vehicle_client.shell.live").joinpath("advisory.dbc").read_text(encoding="utf-8")
        # No string of the file says a type; cantools returns what the format calls for.
        database: Any = cantools.database.load_string(text, database_format="dbc")
        self._message: Any = database.get_message_by_name(MESSAGE_NAME)
        self.frame_id: int = self._message.frame_id if frame_id is None else frame_id
        self._counter = 0

    def frame_of(self, shown: ShownAdvice | None, *, inside: bool, now_s: float) -> bytes:
        """Return the eight bytes that show advice, or take it away when there is none."""
        values: dict[str, float] = {
            "SpeedKmh": NONE_VALUE,
            "FrictionLowPercent": NONE_VALUE,
            "ValidForS": 0,
            "Confidence": 0,
            "Shown": 0,
            "Inside": int(inside),
            "Counter": self._counter,
            "Checksum": 0,
        }
        if shown is not None:
            advisory = shown.advisory
            values |= {
                # Never above the advice, and never "none".
                "SpeedKmh": min(NONE_VALUE - 1, int(mps_to_kph(advisory.speed_mps) + 1e-6)),
                "ValidForS": min(65_534, max(0, int(shown.expires_s - now_s))),
                "Confidence": _CONFIDENCES[advisory.confidence],
                "Shown": 1,
            }
            if advisory.interval is not None:
                values["FrictionLowPercent"] = min(NONE_VALUE - 1, int(100.0 * advisory.interval.mu_low + 1e-6))
        self._counter = (self._counter + 1) % 16
        # Strict encoding refuses 255 as out of range; here it is a word of its own.
        data = bytearray(self._message.encode(values, strict=False))
        data[7] = crc8_j1850(bytes(data[:7]))
        return bytes(data)


class AdvisorySender:
    """Puts advice on a bus."""

    def __init__(self, bus: BusABC, frames: AdvisoryFrames) -> None:
        """Take an open bus; whoever opened it shuts it down."""
        self._bus = bus
        self._frames = frames

    def __call__(self, shown: ShownAdvice | None, inside: bool, now_s: float, /) -> bool:  # noqa: FBT001 - a callback
        """Return whether the bus took the frame."""
        data = self._frames.frame_of(shown, inside=inside, now_s=now_s)
        return send_frame(self._bus, self._frames.frame_id, data)


def crc8_j1850(data: bytes) -> int:
    """Return the checksum of the frame.

    References:
        SAE J1850, cyclic redundancy check; check value of "123456789" is 0x4B.
    """
    remainder = 0xFF
    for byte in data:
        remainder ^= byte
        for _ in range(8):
            remainder = ((remainder << 1) ^ _POLYNOMIAL if remainder & 0x80 else remainder << 1) & 0xFF
    return remainder ^ 0xFF
