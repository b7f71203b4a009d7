"""Messages of one exchange to frames and back, as they fly."""

from __future__ import annotations

from typing import TYPE_CHECKING

from roadgrip.exchange import FROM_UNIT, message_of
from roadgrip.frames import Reassembler, exchange_id_of, parse_frame, section_key_of, split_into_frames
from roadgrip.protocol import FRAME_LIMIT_BYTES
from roadgrip.records import RSU_FRAME_BUDGET
from roadgrip.wire import encode_message, kind_of

if TYPE_CHECKING:
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
    ) -> None:
        """Prepare for one exchange.

        Args:
            passage_id: 16 bytes.
            section_id: The section it is about.
            timeout_s: How long an incomplete message is kept, on the exchange's clock.
            signer: Signs what the vehicle sends.
            verifier: The keys of units that the vehicle believes.
        """
        self._exchange_id = exchange_id_of(passage_id)
        self._section_key = section_key_of(section_id)
        self._signer = signer
        self._verifier = verifier
        self._reassembler = Reassembler(
            limit_count=INCOMPLETE_LIMIT_COUNT, limit_bytes=INCOMPLETE_LIMIT_BYTES, timeout_s=timeout_s
        )

    def frames_of(self, message: Message) -> tuple[bytes, ...]:
        """Return the frames that carry a message."""
        return split_into_frames(
            kind_of(message),
            encode_message(message, signer=self._signer),
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
        return message_of(complete, expected=FROM_UNIT, verifier=self._verifier)
