"""Messages of one exchange to frames and back, as they fly."""

from __future__ import annotations

from typing import TYPE_CHECKING

from roadgrip.errors import WireError
from roadgrip.exchange import FROM_UNIT, message_of
from roadgrip.frames import Reassembler, exchange_id_of, parse_frame, section_key_of, split_into_frames
from roadgrip.protocol import FRAME_LIMIT_BYTES
from roadgrip.reasons import Reason
from roadgrip.records import RSU_FRAME_BUDGET, Accepted, Passage, Receipt
from roadgrip.signing import Claims
from roadgrip.wire import Received, encode_message, kind_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from roadgrip.records import Message
    from roadgrip.signing import Signer, Verifier

INCOMPLETE_LIMIT_COUNT = 8
"""Messages of several frames gathered at one time; a unit sends one, the map."""
INCOMPLETE_LIMIT_BYTES = INCOMPLETE_LIMIT_COUNT * RSU_FRAME_BUDGET * FRAME_LIMIT_BYTES


class WireCodec:
    """The wire format, seen from one vehicle in one exchange."""

    def __init__(
        self,
        passage_id: bytes,
        *,
        section_id: str,
        timeout_s: float,
        signer: Signer | None = None,
        verifier: Verifier | None = None,
        unix_s: Callable[[], float | None] = lambda: None,
    ) -> None:
        """Prepare for one exchange.

        Args:
            passage_id: 16 bytes.
            section_id: The section it is about.
            timeout_s: How long an incomplete message is kept, on the exchange's clock.
            signer: Signs what the vehicle sends.
            verifier: The units that the vehicle believes; others, and those who do not sign, it ignores. None believes
                everybody.
            unix_s: The vehicle's wall clock, or None while it cannot be trusted.
        """
        self._exchange_id = exchange_id_of(passage_id)
        self._section_key = section_key_of(section_id)
        self._signer = signer
        self._verifier = verifier
        self._unix_s = unix_s
        self._told_map_version = ""
        self._reassembler = Reassembler(
            limit_count=INCOMPLETE_LIMIT_COUNT, limit_bytes=INCOMPLETE_LIMIT_BYTES, timeout_s=timeout_s
        )

    def frames_of(self, message: Message) -> tuple[bytes, ...]:
        """Return the frames that carry a message; one that is signed says when it was sent, so it is signed anew."""
        if isinstance(message, Passage):
            self._told_map_version = message.map_version
        now_unix_s = None if self._signer is None else self._unix_s()
        claims = Claims(issued_unix_s=None if now_unix_s is None else int(now_unix_s))
        return split_into_frames(
            kind_of(message),
            encode_message(message, signer=self._signer, claims=claims),
            exchange_id=self._exchange_id,
            section_key=self._section_key,
        )

    def message_of(self, frame: bytes, *, now_s: float) -> Message | None:
        """Return the message that this frame completes, or None while frames of it are missing or it is not ours.

        Raises:
            WireError: The frame, or the message it completes, cannot be read or is not believed.
        """
        parsed = parse_frame(frame)
        if parsed.exchange_id != self._exchange_id:
            return None
        complete = self._reassembler.offer(parsed, source=None, now_s=now_s)
        if complete is None:
            return None
        received = message_of(
            complete,
            expected=FROM_UNIT,
            verifier=self._verifier,
            required=self._verifier is not None,
            now_unix_s=self._unix_s(),
        )
        self._check_receipt(received)
        return received.message

    def _check_receipt(self, received: Received) -> None:
        """Raise if a unit has accepted a summary that was cut with another map than it claims to go by."""
        message, signed = received
        accepted = isinstance(message, Receipt) and isinstance(message.outcome, Accepted)
        if accepted and signed is not None and signed.claims.map_version != self._told_map_version:
            raise WireError(Reason.MALFORMED, "the receipt is signed for another map than the summary was cut with")
