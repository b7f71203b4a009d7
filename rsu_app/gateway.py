"""Frames in, frames out, whatever carries them: the same exchange over a radio and over cellular.

The gateway knows no socket and no request. It parses and counts frames, keeps the budget of each exchange, reads
messages, and turns what the unit says into frames again::

    ARRIVAL -> COOKIE, until it comes with the cookie            over UDP: did it come from where it says?
            -> MAP (unless the vehicle has it) + ADVISORY        `take` answers at once
    SUMMARY -> the unit ingests -> RECEIPT, after the commit      `take` hands it out, `settle` answers
    refused -> RECEIPT with the reason, where the exchange is known; so many a second and no more
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import structlog

from roadgrip.errors import WireError
from roadgrip.exchange import FROM_VEHICLE, ExchangeLedger, Reception
from roadgrip.frames import (
    EXCHANGE_ID_BYTES,
    Frame,
    Reassembler,
    answerable_exchange,
    exchange_id_of,
    parse_frame,
    section_key_of,
    split_into_frames,
    unread_passage_id,
)
from roadgrip.protocol import Kind
from roadgrip.reasons import Reason
from roadgrip.records import (
    RSU_FRAME_BUDGET,
    Arrival,
    Beacon,
    Cookie,
    MapOffer,
    Message,
    Outcome,
    Passage,
    Receipt,
    Rejected,
)
from roadgrip.wire import decode_message, encode_message, kind_of
from rsu_app.intake import PassageIntake, into
from rsu_app.observability import Metrics
from rsu_app.rate import RateLimit
from rsu_app.sender_guards import SenderGuards
from rsu_app.signatures import Signatures
from rsu_app.usecases import RoadSideUnit

_log = structlog.get_logger("roadgrip")

RECEIPTS_RESERVED_COUNT = 2
"""Frames of the unit's budget that a repeated ARRIVAL cannot use up: without a receipt the vehicle would never stop."""
ASSEMBLY_LIMIT_COUNT = 256
ASSEMBLY_LIMIT_BYTES = 1_048_576
ASSEMBLY_TIMEOUT_S = 30.0
"""Both messages of a vehicle fit one frame today, so these bound what should not be there at all."""
REFUSAL_LINES_PER_S = 5.0
"""Log lines about refused frames: enough to see what comes, while the metric counts every one. A log has a budget."""
MAPS_KEPT_COUNT = 64


class OutFrames(NamedTuple):
    """The frames of one message that leaves."""

    name: str
    frames: tuple[bytes, ...]


class Taken(NamedTuple):
    """What a datagram led to: answers to send now, and a passage that is to be settled."""

    replies: tuple[OutFrames, ...] = ()
    passage: Passage | None = None


class Sender(NamedTuple):
    """Where a datagram came from.

    Attributes:
        host: Address; empty when nobody knows.
        port: Port.
        proven: Whether it is known to read what is sent to it, as over TCP. What goes to others is never longer than
            what came from them, or the unit could be made to flood a stranger.
    """

    host: str = ""
    port: int = 0
    proven: bool = True


SOMEBODY = Sender()
NOTHING = Taken()
_NAMES = {kind: kind.name.lower() for kind in Kind}


class FrameGateway:
    """One unit's side of every exchange.

    Args:
        unit: Answers.
        intake: Takes passages; bounded there.
        ledger: Counts frames per exchange.
        metrics: Counts everything.
        now_s: The clock that budgets and time-outs go by.
        random_bytes: Gives ids to messages that belong to no passage.
        refusals_per_s: Rejections that may be sent in a second.
        signatures: Signs what leaves and checks what comes.
        guards: What each sender may do at most.
    """

    def __init__(
        self,
        *,
        unit: RoadSideUnit,
        intake: PassageIntake,
        ledger: ExchangeLedger,
        metrics: Metrics,
        now_s: Callable[[], float],
        random_bytes: Callable[[int], bytes],
        refusals_per_s: float,
        signatures: Signatures,
        guards: SenderGuards | None = None,
    ) -> None:
        self._unit = unit
        self._intake = intake
        self._ledger = ledger
        self._metrics = metrics
        self._now_s = now_s
        self._random_bytes = random_bytes
        self._refusals = RateLimit(refusals_per_s)  # a flood of rubbish must not make the unit a source of another
        self._refusal_lines = RateLimit(REFUSAL_LINES_PER_S)
        self._signatures = signatures
        self._guards = guards or SenderGuards()
        self._places = {
            section_key_of(offer.section.section_id): (offer.section.section_id, offer.section.version)
            for offer in map(unit.map_offer, unit.section_ids)
            if isinstance(offer, MapOffer)
        }
        self._reassembler = Reassembler(
            limit_count=ASSEMBLY_LIMIT_COUNT, limit_bytes=ASSEMBLY_LIMIT_BYTES, timeout_s=ASSEMBLY_TIMEOUT_S
        )
        self._maps: dict[tuple[object, ...], bytes] = {}

    def is_allowed(self, sender: Sender) -> bool:
        """Return whether a sender may say something more now, and count it if so; `take` asks by itself."""
        return self._guards.frame_allowed(sender.host, now_s=self._now_s())

    def take(self, datagram: bytes, *, via: str, sender: Sender = SOMEBODY) -> Taken:
        """Return what to answer at once and what to settle. Never raises, whatever the bytes are.

        Args:
            datagram: One frame, or rubbish.
            via: The transport, for the metrics.
            sender: Where it came from.
        """
        now_s = self._now_s()
        self._metrics.frames_received.count(via)
        try:
            frame = parse_frame(datagram)
        except WireError as error:
            exchange_id = answerable_exchange(datagram, error.reason)
            return self._refused(
                error, exchange_id, datagram[4:8], via=via, now_s=now_s, limit_bytes=_limit_bytes(datagram, sender)
            )
        if frame.kind not in FROM_VEHICLE:
            # Another unit, or our own broadcast that came back: not for us, and nobody to answer.
            self._metrics.frames_dropped.count(via, "not_for_units")
            return NOTHING
        limit_bytes = _limit_bytes(datagram, sender)
        try:
            if not self.is_allowed(sender):
                raise WireError(Reason.RATE_LIMITED, "more frames a second than one address may send")  # noqa: TRY301
            if frame.kind is Kind.ARRIVAL and not sender.proven:
                # Before any signature is looked at: who forges addresses must not cost more than a digest.
                asked_back = self._asked_back(frame, sender, now_s=now_s)
                if asked_back:
                    return Taken(asked_back)
                limit_bytes = None
            return self._read(frame, via=via, sender=sender, now_s=now_s)
        except WireError as error:
            return self._refused(
                error, frame.exchange_id, frame.section_key, via=via, now_s=now_s, limit_bytes=limit_bytes
            )

    async def settle(self, passage: Passage, *, via: str) -> tuple[OutFrames, ...]:
        """Return the receipt of a passage, after the commit that holds it; nothing if the budget is used up."""
        return await self.settling(passage, via=via)

    def settling(self, passage: Passage, *, via: str) -> asyncio.Future[tuple[OutFrames, ...]]:
        """Return what will hold the receipt of a passage, which is in work from now on; see `settle`."""
        receipt: asyncio.Future[tuple[OutFrames, ...]] = asyncio.get_running_loop().create_future()
        self._intake.offer(passage, via=via, answer=into(receipt, partial(self._receipt, passage)))
        return receipt

    def settle_later(self, passage: Passage, *, via: str, send: Callable[[tuple[OutFrames, ...]], object]) -> None:
        """Hand the receipt of a passage to `send`, once, after the commit that holds it.

        For who does not wait; see `settle`. After a failure of the unit, which the log has, there is nothing to send.
        """

        def answer(outcome: Outcome | Exception) -> None:
            send(() if isinstance(outcome, Exception) else self._receipt(passage, outcome))

        self._intake.offer(passage, via=via, answer=answer)

    def _receipt(self, passage: Passage, outcome: Outcome) -> tuple[OutFrames, ...]:
        exchange_id = exchange_id_of(passage.passage_id)
        out = self._out(
            Receipt(passage.passage_id, outcome),
            exchange_id=exchange_id,
            section_key=section_key_of(passage.section_id),
        )
        return self._reserved(out, exchange_id=exchange_id, now_s=self._now_s())

    def beacons(self) -> tuple[OutFrames, ...]:
        """Return the announcement of each section."""
        return tuple(self._announced(self._unit.beacon(section_id)) for section_id in self._unit.section_ids)

    def guidance(self, section_id: str) -> tuple[OutFrames, ...]:
        """Return map and advisory of a section for everybody in reach, who asked for nothing.

        Raises:
            WireError: UNKNOWN_SECTION.
        """
        exchange_id = self._random_bytes(EXCHANGE_ID_BYTES)
        return self._guidance(section_id, known_map_version="", exchange_id=exchange_id)

    def map_message(self, offer: MapOffer) -> bytes:
        """Return the message MAP, encoded once for each map and signed anew now and then."""
        section = offer.section
        known_as = (section.version, offer.table_digests, *self._signatures.map_period())
        payload = self._maps.get(known_as)
        if payload is None:
            if len(self._maps) >= MAPS_KEPT_COUNT:
                self._maps.clear()
            payload = self._maps[known_as] = self._signatures.written(
                offer, exchange_id=b"", section_id=section.section_id, map_version=section.version
            )
        return payload

    def observe(self) -> None:
        """Bring the gauges up to date."""
        if (signer := self._signatures.trust.signer) is not None:
            self._metrics.signing_certificate_ends.set(signer.certificate.valid_until_unix_s)
        counters = self._reassembler.counters
        self._metrics.assemblies.set(self._reassembler.held_count)
        self._metrics.assemblies_given_up.set(counters.evicted_count + counters.expired_count)
        self._metrics.exchanges.set(self._ledger.open_count)
        self._metrics.exchanges_evicted.set(self._ledger.counters.evicted_count)

    def _read(self, frame: Frame, *, via: str, sender: Sender, now_s: float) -> Taken:
        if frame.kind is Kind.SUMMARY and self._intake.full:
            # Before it is read or counted: under a flood, refusing must cost a fraction of accepting.
            raise WireError(Reason.BUSY, "as many passages are in work as this unit takes")
        match self._ledger.receive(frame, now_s=now_s):
            case Reception.EXHAUSTED:
                raise WireError(Reason.BUDGET_EXHAUSTED, "the vehicle has used up its frames")
            case Reception.DUPLICATE:
                self._metrics.frame_duplicates.count(via)
            case Reception.NEW:
                pass
        complete = self._reassembler.offer(frame, source=(via, sender), now_s=now_s)
        if complete is None:
            return NOTHING
        message, signed = self._signatures.read(complete, via=via)
        self._metrics.messages_received.count(via, _NAMES[frame.kind])
        match message:
            case Arrival():
                return Taken(self._welcome(message, now_s=now_s))
            case Passage():
                if signed is not None and not self._guards.passage_allowed(
                    message, certificate_id=signed.certificate.certificate_id, now_s=now_s
                ):
                    raise WireError(Reason.RATE_LIMITED, "more passages an hour than one certificate may report")
                return Taken(passage=message)
            case _:  # `message_of` has refused the rest
                return NOTHING

    def _asked_back(self, frame: Frame, sender: Sender, *, now_s: float) -> tuple[OutFrames, ...]:
        """Return the cookie that an arrival must be repeated with, nothing if it need not.

        Raises:
            WireError: It is no arrival.
        """
        arrival = decode_message(Kind.ARRIVAL, frame.fragment)
        assert isinstance(arrival, Arrival)  # noqa: S101 - by its kind
        cookie = self._guards.cookie_wanted(
            arrival.cookie, host=sender.host, port=sender.port, exchange_id=frame.exchange_id, now_s=now_s
        )
        if cookie is None:
            return ()
        frames = split_into_frames(
            Kind.COOKIE,
            encode_message(Cookie(cookie)),
            exchange_id=frame.exchange_id,
            section_key=frame.section_key,
        )
        return self._reserved(OutFrames(_NAMES[Kind.COOKIE], frames), exchange_id=frame.exchange_id, now_s=now_s)

    def _welcome(self, arrival: Arrival, *, now_s: float) -> tuple[OutFrames, ...]:
        exchange_id = exchange_id_of(arrival.passage_id)
        messages = self._guidance(
            arrival.section_id, known_map_version=arrival.known_map_version, exchange_id=exchange_id
        )
        sent_count = self._ledger.sent_count(exchange_id)
        if sent_count:
            # The first answer may cost what it must; later ones leave room for receipts, the advice before the map.
            left_count = RSU_FRAME_BUDGET - RECEIPTS_RESERVED_COUNT - sent_count
            *maps, advisory = messages
            needed_count = sum(len(m.frames) for m in messages)
            if needed_count > left_count:
                self._withhold(*maps)
                messages = (advisory,)
                if left_count < len(advisory.frames):
                    self._withhold(advisory)
                    return ()
        return self._reserved(*messages, exchange_id=exchange_id, now_s=now_s)

    def _guidance(self, section_id: str, *, known_map_version: str, exchange_id: bytes) -> tuple[OutFrames, ...]:
        offer, notice = self._unit.map_offer(section_id), self._unit.advisory_notice(section_id)
        if isinstance(offer, Rejected):
            raise WireError(offer.reason, offer.detail)
        if isinstance(notice, Rejected):
            raise WireError(notice.reason, notice.detail)
        section_key = section_key_of(section_id)
        advisory = self._out(notice, exchange_id=exchange_id, section_key=section_key)
        if known_map_version == offer.section.version:
            return (advisory,)
        return (self._out(offer, exchange_id=exchange_id, section_key=section_key), advisory)

    def _announced(self, beacon: Beacon | Rejected) -> OutFrames:
        assert not isinstance(beacon, Rejected)  # noqa: S101 - the unit was asked for its own sections
        return self._out(
            beacon,
            exchange_id=self._random_bytes(EXCHANGE_ID_BYTES),
            section_key=section_key_of(beacon.section_id),
        )

    def _out(self, message: Message, *, exchange_id: bytes, section_key: bytes) -> OutFrames:
        kind = kind_of(message)
        section_id, map_version = self._places.get(section_key, ("", ""))
        payload = (
            self.map_message(message)
            if isinstance(message, MapOffer)
            else self._signatures.written(
                message, exchange_id=exchange_id, section_id=section_id, map_version=map_version
            )
        )
        frames = split_into_frames(kind, payload, exchange_id=exchange_id, section_key=section_key)
        return OutFrames(_NAMES[kind], frames)

    def _reserved(self, *messages: OutFrames, exchange_id: bytes, now_s: float) -> tuple[OutFrames, ...]:
        """Return the messages that the exchange's budget still has room for, each whole or not at all."""
        kept = []
        for message in messages:
            if self._ledger.reserve(exchange_id, frames_count=len(message.frames), now_s=now_s):
                kept.append(message)
            else:
                self._withhold(message)
        return tuple(kept)

    def _withhold(self, *messages: OutFrames) -> None:
        for message in messages:
            self._metrics.frames_withheld.count(message.name, by=len(message.frames))

    def _refused(
        self,
        error: WireError,
        exchange_id: bytes | None,
        section_key: bytes,
        *,
        via: str,
        now_s: float,
        limit_bytes: int | None,
    ) -> Taken:
        """Count what was refused, and return the receipt that says so where there is somebody to tell.

        Args:
            error: Why.
            exchange_id: Whom to tell; None: nobody.
            section_key: Of the frame.
            via: The transport.
            now_s: Now.
            limit_bytes: What may be sent to an address that is not proven; None: as much as needed.
        """
        self._metrics.frames_dropped.count(via, error.reason.value)
        self._metrics.latest_refusals.note(
            reason=error.reason.value, section="", via=via, detail=error.detail, now_s=now_s
        )
        if self._refusal_lines.take(now_s=now_s):
            _log.info("frame_refused", reason=error.reason.value, detail=error.detail[:200], via=via)
        if exchange_id is None:
            return NOTHING
        if not self._refusals.take(now_s=now_s):
            self._metrics.refusals_withheld.count()
            return NOTHING
        # Without its detail where that would be longer than what came: the reason is what a vehicle acts by.
        for detail in (error.detail, ""):
            receipt = Receipt(unread_passage_id(exchange_id), Rejected(error.reason, detail))
            out = self._out(receipt, exchange_id=exchange_id, section_key=section_key)
            if limit_bytes is None or sum(map(len, out.frames)) <= limit_bytes:
                return Taken(self._reserved(out, exchange_id=exchange_id, now_s=now_s))
        self._metrics.refusals_withheld.count()
        return NOTHING


def _limit_bytes(datagram: bytes, sender: Sender) -> int | None:
    return None if sender.proven else len(datagram)
