r"""What one vehicle says to a road side unit during one passage, and what it makes of the answers.

A state machine without sockets and without a clock: time is an argument, frames go in and come out. The shell around
it (`vehicle_client.shell.conversation`) carries the frames::

    begin() -> ARRIVING --map and advisory, or tries spent--> DRIVING --report()--> REPORTING --receipt--> ENDED
                   ^-----------------renew()-------------------/ \--withhold()----------------------------/

Three promises hold whatever the air does: at most `VEHICLE_FRAME_BUDGET` frames leave in one passage, retransmissions
included; a receipt that accepts the passage ends the exchange; what comes twice, late, spoiled or for somebody else
changes nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import inf
from typing import TYPE_CHECKING, Protocol

from roadgrip.errors import WireError
from roadgrip.features import older_summary, summary_among
from roadgrip.frames import exchange_id_of, unread_passage_id
from roadgrip.records import (
    VEHICLE_FRAME_BUDGET,
    Accepted,
    Advisory,
    AdvisoryNotice,
    Arrival,
    Cookie,
    KinematicSummary,
    MapOffer,
    Message,
    Outcome,
    Passage,
    Reason,
    Receipt,
    Rejected,
)
from vehicle_client.shell.patience import Patience

if TYPE_CHECKING:
    from roadgrip.section import RoadSection


COOKIES_LIMIT_COUNT = 2
"""Cookies that are followed in one exchange: one, and another if it came too late. A forged one costs a frame."""


class FrameCodec(Protocol):
    """Messages to frames and back; one codec belongs to one exchange."""

    def frames_of(self, message: Message) -> tuple[bytes, ...]:
        """Return the frames that carry a message."""
        ...

    def message_of(self, frame: bytes, *, now_s: float) -> Message | None:
        """Return the message that this frame completes, or None while frames of it are missing or it is not ours.

        Raises:
            WireError: The frame, or the message it completes, is not of ours.
        """
        ...


class Stage(StrEnum):
    """Where an exchange stands."""

    NEW = "new"
    ARRIVING = "arriving"
    DRIVING = "driving"
    REPORTING = "reporting"
    ENDED = "ended"


class Ending(StrEnum):
    """How an exchange ended."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    """The unit refused for good; sending it again would change nothing."""
    POSTPONED = "postponed"
    """The unit refused for now and tries are spent; the spool may try later."""
    UNANSWERED = "unanswered"
    """No receipt came; the spool may try later."""
    WITHHELD = "withheld"
    """The vehicle kept its summary to itself, for the reason in `ExchangeRecord.withheld`."""
    NO_MAP = "no_map"
    """The vehicle never got the map, so there is nothing to cut a summary with."""


@dataclass(frozen=True, slots=True)
class ExchangeRecord:
    """How an exchange went.

    Attributes:
        passage_id: The passage it was about.
        ending: How it ended.
        outcome: What the unit's last receipt said, if one came.
        withheld: Why the vehicle kept its summary, if it did.
        advisory: The advice the vehicle drove with, if it came.
        map_version: The map the vehicle drove with, or the empty string.
        frames_sent_count: Frames of the budget that were used, retransmissions included.
        frames_received_count: Frames that arrived, duplicates included.
        frames_refused_count: Frames among them that were spoiled or not of ours.
        messages_ignored_count: Whole messages that were for somebody else or came once more.
        arrival_tries_count: How often the arrival was announced.
        report_tries_count: How often the summary was sent.
        refusals: Frames that were spoiled, not of ours or not believed, by reason.
    """

    passage_id: bytes
    ending: Ending
    outcome: Outcome | None
    withheld: Reason | None
    advisory: Advisory | None
    map_version: str
    frames_sent_count: int
    frames_received_count: int
    frames_refused_count: int
    messages_ignored_count: int
    arrival_tries_count: int
    report_tries_count: int
    refusals: Mapping[Reason, int] = field(default_factory=dict)

    @property
    def may_spool(self) -> bool:
        """Whether the summary may still be delivered later."""
        return self.ending in {Ending.POSTPONED, Ending.UNANSWERED}


class Exchange:
    """One vehicle's side of one passage's exchange.

    Every method that lets time pass takes `now_s`, seconds on any clock that never runs backwards, and returns the
    frames to send now, in order. `wake_at_s` says when `tick` is next due.
    """

    def __init__(
        self,
        *,
        passage_id: bytes,
        section_id: str,
        codec: FrameCodec,
        known_section: RoadSection | None = None,
        patience: Patience | None = None,
        frames_spent_count: int = 0,
        frame_budget_count: int = VEHICLE_FRAME_BUDGET,
    ) -> None:
        """Prepare an exchange; nothing is sent before `begin` or `report`.

        Args:
            passage_id: 16 random bytes.
            section_id: The section that will be driven.
            codec: Turns messages into frames and back.
            known_section: The map, if the vehicle has it from an earlier passage.
            patience: How long to wait and how often to try.
            frames_spent_count: Frames already used for this passage, when a spooled summary is delivered later.
            frame_budget_count: Frames that may leave in this passage.
        """
        self._passage_id = passage_id
        self._unread_id = unread_passage_id(exchange_id_of(passage_id))
        self._section_id = section_id
        self._codec = codec
        self._section = known_section
        self._patience = patience if patience is not None else Patience()
        self._budget_count = frame_budget_count
        self._stage = Stage.NEW
        self._notice: AdvisoryNotice | None = None
        self._advice_due = True
        self._tables: tuple[str, ...] | None = None
        self._passage: Passage | None = None
        self._words_sent = False
        self._words_changed = False
        self._left_at_s = 0.0
        self._wake_at_s = inf
        self._outcome: Outcome | None = None
        self._withheld: Reason | None = None
        self._ending: Ending | None = None
        self._sent_count = frames_spent_count
        self._received_count = 0
        self._refusals: Counter[Reason] = Counter()
        self._cookie = b""
        self._cookies_count = 0
        self._cookie_due = False
        self._ignored_count = 0
        self._arrival_tries_count = 0
        self._report_tries_count = 0

    @property
    def stage(self) -> Stage:
        """Where the exchange stands."""
        return self._stage

    @property
    def wake_at_s(self) -> float:
        """When `tick` is next due; infinite while nothing is awaited."""
        return self._wake_at_s

    @property
    def section(self) -> RoadSection | None:
        """The map, once it is known."""
        return self._section

    @property
    def advisory(self) -> Advisory | None:
        """The advice, once it came."""
        return None if self._notice is None else self._notice.advisory

    @property
    def notice(self) -> AdvisoryNotice | None:
        """What brought the advice; another object whenever the unit gave it anew."""
        return self._notice

    @property
    def frames_sent_count(self) -> int:
        """Frames of the budget used so far."""
        return self._sent_count

    def begin(self, *, now_s: float) -> tuple[bytes, ...]:
        """Announce the vehicle and ask for map and advisory."""
        if self._stage is not Stage.NEW:
            message = f"an exchange begins once; this one is {self._stage}"
            raise ValueError(message)
        self._stage = Stage.ARRIVING
        return self._announce(now_s)

    def renew(self, *, now_s: float) -> tuple[bytes, ...]:
        """Announce the vehicle again for fresh advice, unless its announcements or the budget are spent."""
        if self._stage is not Stage.DRIVING or self._arrival_tries_count >= self._patience.arrival_tries_count:
            return ()
        self._stage = Stage.ARRIVING
        self._advice_due = True
        return self._announce(now_s)

    def reserve(self) -> int:
        """Return how many frames of the budget a report may have used when it ends, and hold it to that.

        Written down before the first of them leaves, it keeps the budget also for a vehicle that is switched off.
        """
        self._budget_count = min(self._budget_count, self._sent_count + self._patience.report_tries_count)
        return self._budget_count

    def report(
        self, summary: KinematicSummary, *, map_version: str, left_at_s: float, now_s: float
    ) -> tuple[bytes, ...]:
        """Send a summary; if no advisory has come by now, the vehicle stops asking for one.

        It is told in the words of the newest feature table that both ends speak. When the unit has said that its models
        serve other tables only, nothing is sent and the exchange ends. A vehicle that had the map, and so was not
        told the unit's tables, begins with the newest and goes on to older ones when it is refused for that.

        Args:
            summary: What the pipeline made of the drive.
            map_version: The map it was cut with.
            left_at_s: When the vehicle left the section, on the clock of `now_s`.
            now_s: Now.
        """
        if self._stage in {Stage.REPORTING, Stage.ENDED}:
            message = f"a passage is reported once; this exchange is {self._stage}"
            raise ValueError(message)
        spoken = summary if self._tables is None else summary_among(summary, self._tables)
        if spoken is None:
            self._withheld = Reason.WRONG_FEATURE_TABLE
            return self._end(Ending.WITHHELD)
        self._passage = Passage(self._passage_id, self._section_id, map_version, spoken, age_s=0.0)
        self._left_at_s = left_at_s
        self._stage = Stage.REPORTING
        return self._send(self._passage, now_s)

    def withhold(self, reason: Reason) -> None:
        """End the exchange without a summary, because the drive gave none that may be sent.

        A vehicle without a map that was told why ends refused, for that reason. An exchange that has ended stays
        as it is.
        """
        if self._stage is Stage.REPORTING:
            message = "the summary has already been sent"
            raise ValueError(message)
        if self._stage is Stage.ENDED:
            return
        if self._section is None:
            refused = isinstance(self._outcome, Rejected) and not self._outcome.reason.may_retry
            self._end(Ending.REJECTED if refused else Ending.NO_MAP)
            return
        self._withheld = reason
        self._end(Ending.WITHHELD)

    def tick(self, *, now_s: float) -> tuple[bytes, ...]:
        """Let time pass: try again or give up, whatever is due."""
        if now_s < self._wake_at_s:
            return ()
        if self._stage is Stage.ARRIVING:
            if self._cookie_due:
                return self._announce(now_s, again=True)
            if self._arrival_tries_count >= self._patience.arrival_tries_count:
                self._drive()
                return ()
            return self._announce(now_s)
        if self._passage is not None and self._stage is Stage.REPORTING:
            if self._report_tries_count >= self._patience.report_tries_count:
                return self._give_up()
            return self._send(self._passage, now_s)
        return ()

    def receive(self, frame: bytes, *, now_s: float) -> None:
        """Take a frame from the air."""
        self._received_count += 1
        try:
            message = self._codec.message_of(frame, now_s=now_s)
        except WireError as error:
            self._refusals[error.reason] += 1
            return
        if message is not None and not self._take(message, now_s):
            self._ignored_count += 1

    def record(self) -> ExchangeRecord:
        """Return how the exchange went; before its end, as if it were given up now."""
        return ExchangeRecord(
            passage_id=self._passage_id,
            ending=self._ending if self._ending is not None else Ending.UNANSWERED,
            outcome=self._outcome,
            withheld=self._withheld,
            advisory=self.advisory,
            map_version="" if self._section is None else self._section.version,
            frames_sent_count=self._sent_count,
            frames_received_count=self._received_count,
            frames_refused_count=self._refusals.total(),
            messages_ignored_count=self._ignored_count,
            arrival_tries_count=self._arrival_tries_count,
            report_tries_count=self._report_tries_count,
            refusals=dict(self._refusals),
        )

    # ------------------------------------------------------------------------------------------------- what arrives

    def _take(self, message: Message, now_s: float) -> bool:
        """Return whether the message told something new."""
        if isinstance(message, MapOffer):
            return self._take_map(message)
        if isinstance(message, AdvisoryNotice):
            return self._take_advisory(message)
        if isinstance(message, Receipt):
            return self._take_receipt(message, now_s)
        if isinstance(message, Cookie):
            return self._take_cookie(message, now_s)
        return False

    def _take_cookie(self, cookie: Cookie, now_s: float) -> bool:
        """Repeat the announcement at once with the cookie, as proof that what the unit sends arrives here."""
        if (
            self._stage is not Stage.ARRIVING
            or cookie.cookie == self._cookie
            or self._cookies_count >= COOKIES_LIMIT_COUNT
        ):
            return False
        self._cookie = cookie.cookie
        self._cookies_count += 1
        self._cookie_due = True
        self._wake_at_s = now_s
        return True

    def _take_map(self, offer: MapOffer) -> bool:
        # After the summary was cut a new map would contradict it.
        if offer.section.section_id != self._section_id or self._stage not in {Stage.ARRIVING, Stage.DRIVING}:
            return False
        self._tables = offer.table_digests
        if self._section is not None and self._section.version == offer.section.version:
            return False
        self._section = offer.section
        self._drive_when_complete()
        return True

    def _take_advisory(self, notice: AdvisoryNotice) -> bool:
        if notice.section_id != self._section_id or self._stage not in {Stage.ARRIVING, Stage.DRIVING}:
            return False
        if notice == self._notice and (notice.issued_unix_s > 0 or not self._advice_due):
            # Late or played again: it must not hold longer than it was given for.
            return False
        self._notice = notice
        self._advice_due = False
        if self._section is not None and self._section.version != notice.map_version and self._stage is Stage.ARRIVING:
            # The road was mapped anew since the vehicle last came by; the next announcement asks for that map.
            self._section = None
        self._drive_when_complete()
        return True

    def _take_receipt(self, receipt: Receipt, now_s: float) -> bool:
        outcome = receipt.outcome
        repeated = outcome == self._outcome
        if self._stage is Stage.ENDED:
            return False
        if receipt.passage_id == self._unread_id and isinstance(outcome, Rejected):
            # The unit could not read what we sent. Whoever heard a frame's header could say so too, so this alone
            # ends nothing; it is what the exchange ends with if every further try fares alike.
            self._outcome = outcome
            return not repeated
        if receipt.passage_id != self._passage_id:
            return False
        if isinstance(outcome, Accepted):
            if self._stage is not Stage.REPORTING:
                return False
            self._outcome = outcome
            self._end(Ending.ACCEPTED)
            return True
        self._outcome = outcome
        if outcome.reason is Reason.WRONG_FEATURE_TABLE and self._stage is Stage.REPORTING:
            return self._take_other_words(now_s) or not repeated
        if not outcome.reason.may_retry:
            self._end(Ending.REJECTED)
        elif self._stage is Stage.REPORTING and not repeated:
            # Every try earns one answer; a duplicate of it must not push the next try further away.
            wait_s = self._patience.wait_s(self._patience.postpone_s, tries_count=self._report_tries_count)
            self._wake_at_s = now_s + wait_s
        return not repeated

    def _take_other_words(self, now_s: float) -> bool:
        """Return whether the summary is told in older words from now on, after the unit refused its feature table.

        A refusal does not say which table it means, so one that comes twice must not end the exchange: once other
        words have been tried, what remains of the tries decides.
        """
        if self._passage is None or not self._words_sent:
            return False
        older = older_summary(self._passage.summary)
        if older is not None:
            self._passage = replace(self._passage, summary=older)
            self._words_sent = False
            self._words_changed = True
            self._wake_at_s = now_s
        elif not self._words_changed:
            self._end(Ending.REJECTED)
        return older is not None

    # ---------------------------------------------------------------------------------------------------- what leaves

    def _announce(self, now_s: float, *, again: bool = False) -> tuple[bytes, ...]:
        """Return the announcement; `again` is one with a cookie, which is no further try."""
        self._cookie_due = False
        known = "" if self._section is None else self._section.version
        frames = self._codec.frames_of(Arrival(self._passage_id, self._section_id, known, self._cookie))
        if self._sent_count + len(frames) >= self._budget_count:
            # At least one frame stays for the summary.
            self._drive()
            return ()
        self._arrival_tries_count += not again
        self._sent_count += len(frames)
        self._wake_at_s = now_s + self._patience.wait_s(self._patience.reply_s, tries_count=self._arrival_tries_count)
        return frames

    def _send(self, passage: Passage, now_s: float) -> tuple[bytes, ...]:
        # Encoded anew for every try: the age is the one the message has when it leaves.
        frames = self._codec.frames_of(replace(passage, age_s=max(0.0, now_s - self._left_at_s)))
        if self._sent_count + len(frames) > self._budget_count:
            return self._give_up()
        self._words_sent = True
        self._report_tries_count += 1
        self._sent_count += len(frames)
        self._wake_at_s = now_s + self._patience.wait_s(self._patience.reply_s, tries_count=self._report_tries_count)
        return frames

    def _drive_when_complete(self) -> None:
        if self._stage is Stage.ARRIVING and self._section is not None and not self._advice_due:
            self._drive()

    def _drive(self) -> None:
        self._stage = Stage.DRIVING
        self._wake_at_s = inf

    def _give_up(self) -> tuple[bytes, ...]:
        if not isinstance(self._outcome, Rejected):
            return self._end(Ending.UNANSWERED)
        return self._end(Ending.POSTPONED if self._outcome.reason.may_retry else Ending.REJECTED)

    def _end(self, ending: Ending) -> tuple[bytes, ...]:
        self._stage = Stage.ENDED
        self._ending = ending
        self._wake_at_s = inf
        return ()
