"""The rules of one exchange that both ends keep: which message belongs to it, and how many frames it may cost.

At most twenty frames fly in one passage, twelve of the vehicle and eight of the unit, retransmissions included. Each
end counts what itself sends (`FrameBudget`). A unit, which serves many, also counts what it is sent
(`ExchangeLedger`): a frame that comes a second time, byte by byte, uses up nothing, since nobody can say whether its
sender or the air repeated it.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from enum import Enum

from roadgrip.belief import REPLAY_WINDOW_S, check_unit, check_vehicle
from roadgrip.errors import WireError
from roadgrip.frames import Complete, Frame, exchange_id_of, section_key_of
from roadgrip.protocol import Kind
from roadgrip.reasons import Reason
from roadgrip.records import (
    RSU_FRAME_BUDGET,
    VEHICLE_FRAME_BUDGET,
    AdvisoryNotice,
    Arrival,
    Beacon,
    MapOffer,
    Passage,
    Receipt,
)
from roadgrip.signing import Verifier
from roadgrip.wire import Received, open_message

FROM_VEHICLE = frozenset({Kind.ARRIVAL, Kind.SUMMARY})
"""What a unit reads."""
FROM_UNIT = frozenset({Kind.COOKIE, Kind.MAP, Kind.ADVISORY, Kind.RECEIPT, Kind.BEACON})
"""What a vehicle reads."""


def message_of(
    complete: Complete,
    *,
    expected: frozenset[Kind],
    verifier: Verifier | None = None,
    required: bool = False,
    now_unix_s: float | None = None,
    replay_window_s: float = REPLAY_WINDOW_S,
) -> Received:
    """Return the message that a reassembler completed, if it belongs to its frames and is believed.

    Args:
        complete: What `roadgrip.frames.Reassembler.offer` gave.
        expected: Which kinds the receiver reads, `FROM_VEHICLE` or `FROM_UNIT`.
        verifier: Who is believed; None takes signatures off unread.
        required: Whether an unsigned message is refused. A signed one is judged in any case, if there is a verifier.
        now_unix_s: The receiver's wall clock; None while it cannot be trusted, and then no date is judged.
        replay_window_s: How far from now a vehicle's message may have been sent.

    Raises:
        WireError: As `roadgrip.wire.open_message` and the rules of `roadgrip.belief`, and MALFORMED when the message
            is of an unexpected kind or contradicts its frames' header.
    """
    if complete.kind not in expected:
        raise WireError(Reason.MALFORMED, f"{complete.kind.name} flies the other way")
    received = open_message(
        complete.kind, complete.payload, verifier=verifier, required=required, exchange_id=complete.exchange_id
    )
    message, signed = received
    passage_id: bytes | None = None
    section_id: str | None = None
    match message:
        case Arrival() | Passage():
            passage_id, section_id = message.passage_id, message.section_id
        case Receipt():
            passage_id = message.passage_id
        case MapOffer():
            section_id = message.section.section_id
        case AdvisoryNotice() | Beacon():
            section_id = message.section_id
    if passage_id is not None and exchange_id_of(passage_id) != complete.exchange_id:
        raise WireError(Reason.MALFORMED, "the message belongs to another exchange than its frames")
    if section_id is not None and section_key_of(section_id) != complete.section_key:
        raise WireError(Reason.MALFORMED, "the message is about another section than its frames")
    if signed is not None:
        if complete.kind in FROM_VEHICLE:
            check_vehicle(signed, now_unix_s=now_unix_s, replay_window_s=replay_window_s)
        else:
            check_unit(message, signed, section_key=complete.section_key, now_unix_s=now_unix_s)
    return received


class FrameBudget:
    """The frames that one sender may still send in one passage."""

    def __init__(self, limit_count: int) -> None:
        """Start with `limit_count` frames, such as `VEHICLE_FRAME_BUDGET`."""
        self._left_count = limit_count

    @property
    def left_count(self) -> int:
        """Frames that may still be sent."""
        return self._left_count

    def take(self, frames_count: int) -> bool:
        """Return whether so many frames may be sent, and count them if so. A message is sent whole or not at all."""
        if frames_count > self._left_count:
            return False
        self._left_count -= frames_count
        return True


class Reception(Enum):
    """What a frame that came in means for its exchange's budget."""

    NEW = "new"
    DUPLICATE = "duplicate"
    """Known byte by byte. To be handled like a new one, since the answer may have been lost; it costs nothing."""
    EXHAUSTED = "exhausted"
    """One more than the sender may send. To be refused with `Reason.BUDGET_EXHAUSTED`."""


@dataclass(slots=True)
class LedgerCounters:
    """What a ledger has seen.

    Attributes:
        duplicates_count: Frames that came again.
        refused_count: Frames that came beyond their sender's budget.
        withheld_count: Frames that were not sent, since our own budget was used up.
        evicted_count: Exchanges that were forgotten early, for newer ones.
    """

    duplicates_count: int = 0
    refused_count: int = 0
    withheld_count: int = 0
    evicted_count: int = 0


@dataclass(slots=True)
class _Account:
    last_s: float
    seen: tuple[int, ...] = ()
    sent_count: int = 0


class ExchangeLedger:
    """A unit's count of frames for each exchange, both ways, in bounded memory.

    An exchange is forgotten `timeout_s` after its last frame, or earlier when more than `limit_count` are open; its
    budget then starts anew. The same passage may come by radio and by cellular network, so the source of a frame
    does not matter.
    """

    def __init__(
        self,
        *,
        limit_count: int,
        timeout_s: float,
        sent_limit_count: int = RSU_FRAME_BUDGET,
        received_limit_count: int = VEHICLE_FRAME_BUDGET,
    ) -> None:
        """Start empty.

        Args:
            limit_count: Exchanges that are remembered; one takes at most 1.4 kB.
            timeout_s: How long after its last frame; longer than a late delivery takes.
            sent_limit_count: Frames that we may send in one exchange.
            received_limit_count: Different frames that the other side may send in one exchange.
        """
        self._limit_count = limit_count
        self._timeout_s = timeout_s
        self._sent_limit_count = sent_limit_count
        self._received_limit_count = received_limit_count
        self._accounts: OrderedDict[bytes, _Account] = OrderedDict()
        self.counters = LedgerCounters()

    @property
    def open_count(self) -> int:
        """Exchanges that are remembered."""
        return len(self._accounts)

    def receive(self, frame: Frame, *, now_s: float) -> Reception:
        """Return what a frame that came in means, and count it."""
        account = self._account(frame.exchange_id, now_s=now_s)
        if frame.crc in account.seen:
            self.counters.duplicates_count += 1
            return Reception.DUPLICATE
        if len(account.seen) >= self._received_limit_count:
            self.counters.refused_count += 1
            return Reception.EXHAUSTED
        account.seen += (frame.crc,)  # a dozen at most, and mostly one: a set would take five times the memory
        return Reception.NEW

    def reserve(self, exchange_id: bytes, *, frames_count: int, now_s: float) -> bool:
        """Return whether we may send so many frames in an exchange, and count them as sent if so."""
        account = self._account(exchange_id, now_s=now_s)
        if account.sent_count + frames_count > self._sent_limit_count:
            self.counters.withheld_count += frames_count
            return False
        account.sent_count += frames_count
        return True

    def sent_count(self, exchange_id: bytes) -> int:
        """Return how many frames we have sent in an exchange."""
        account = self._accounts.get(exchange_id)
        return 0 if account is None else account.sent_count

    def received_count(self, exchange_id: bytes) -> int:
        """Return how many different frames have come in an exchange."""
        account = self._accounts.get(exchange_id)
        return 0 if account is None else len(account.seen)

    def _account(self, exchange_id: bytes, *, now_s: float) -> _Account:
        accounts = self._accounts
        while accounts and now_s - next(iter(accounts.values())).last_s > self._timeout_s:
            accounts.popitem(last=False)
        account = accounts.get(exchange_id)
        if account is None:
            account = accounts[exchange_id] = _Account(last_s=now_s)
            if len(accounts) > self._limit_count:
                accounts.popitem(last=False)
                self.counters.evicted_count += 1
        else:
            account.last_s = now_s
            accounts.move_to_end(exchange_id)
        return account
