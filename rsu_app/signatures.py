"""What the unit signs with and whom it believes, listener by listener; replaceable while it runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING

from roadgrip.belief import REPLAY_WINDOW_S, unit_claims
from roadgrip.exchange import FROM_VEHICLE, message_of
from roadgrip.trust import Trust
from roadgrip.wire import Received, encode_message

if TYPE_CHECKING:
    from roadgrip.frames import Complete
    from roadgrip.records import Message

MAP_SIGNED_FOR_S = 3_600
"""A map is signed anew so often, long before its claims end; in between its bytes stay the same, so pieces add up."""


class SignatureMode(StrEnum):
    """What a listener makes of signatures."""

    OFF = "off"
    """Taken off unread."""
    OPTIONAL = "optional"
    """A message that is signed must verify."""
    REQUIRED = "required"
    """An unsigned message is refused."""


ALL_OFF: Mapping[str, SignatureMode] = MappingProxyType({})


class Signatures:
    """Reads what vehicles say as far as it is believed, and writes what the unit says.

    Attributes:
        trust: In use; assign another to go by it from now on.
    """

    def __init__(
        self,
        trust: Trust | None = None,
        *,
        modes: Mapping[str, SignatureMode] = ALL_OFF,
        unix_s: Callable[[], int | None],
        replay_window_s: float = REPLAY_WINDOW_S,
    ) -> None:
        """Start with a trust.

        Args:
            trust: None signs nothing and believes nobody.
            modes: By listener, "udp" and "http"; one that is not named takes signatures off unread.
            unix_s: The wall clock, or None while it cannot be trusted.
            replay_window_s: How far from now a vehicle's message may have been sent.
        """
        self.trust = Trust() if trust is None else trust
        self._modes = dict(modes)
        self._unix_s = unix_s
        self._replay_window_s = replay_window_s

    def read(self, complete: Complete, *, via: str) -> Received:
        """Return the message that a listener was sent, and who has signed it.

        Raises:
            WireError: As `roadgrip.exchange.message_of`.
        """
        mode = self._modes.get(via, SignatureMode.OFF)
        if mode is SignatureMode.OFF:
            return message_of(complete, expected=FROM_VEHICLE)
        return message_of(
            complete,
            expected=FROM_VEHICLE,
            verifier=self.trust.verifier,
            required=mode is SignatureMode.REQUIRED,
            now_unix_s=self._unix_s(),
            replay_window_s=self._replay_window_s,
        )

    def written(self, message: Message, *, exchange_id: bytes, section_id: str, map_version: str) -> bytes:
        """Return the bytes of what the unit says, signed if it has a key.

        Args:
            message: What it says.
            exchange_id: In whose frames it flies.
            section_id: The section it is about; empty for the refusal of what is about no section of this unit.
            map_version: The unit's map of that section.

        Raises:
            WireError: As `roadgrip.wire.encode_message`.
        """
        signer = self.trust.signer
        if signer is None:
            return encode_message(message)
        claims = unit_claims(message, section_id=section_id, map_version=map_version, issued_unix_s=self._unix_s())
        return encode_message(message, signer=signer, exchange_id=exchange_id, claims=claims)

    def map_period(self) -> tuple[bytes, int]:
        """Return what a signed map may be kept for: another value says that it is to be signed anew."""
        signer, unix_s = self.trust.signer, self._unix_s()
        if signer is None:
            return b"", 0
        return signer.certificate.certificate_id, 0 if unix_s is None else 1 + unix_s // MAP_SIGNED_FOR_S
