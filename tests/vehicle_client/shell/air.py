"""A codec without an encoding and a road side unit without a model, for tests of one vehicle's exchange."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from itertools import count

import numpy as np

from roadgrip.errors import WireError
from roadgrip.features import NEWEST_TABLE
from roadgrip.records import (
    Accepted,
    Advisory,
    AdvisoryNotice,
    AdvisoryReason,
    Arrival,
    Confidence,
    KinematicSummary,
    MapOffer,
    Message,
    Outcome,
    Passage,
    Reason,
    Receipt,
)
from roadgrip.section import RoadSection, build_section
from vehicle_client.shell.exchange import Exchange, Stage

PASSAGE_ID = bytes(range(16))


def bend(section_id: str = "bend", *, speed_limit_mps: float = 20.0) -> RoadSection:
    angle_rad = np.linspace(0.0, 1.0, 12)
    nodes = np.column_stack([150.0 * np.sin(angle_rad), 150.0 * (1.0 - np.cos(angle_rad)), np.zeros(12)])
    return build_section(section_id=section_id, name=section_id, nodes_m=nodes, speed_limit_mps=speed_limit_mps)


BEND = bend()
ADVICE = Advisory(
    speed_mps=13.89,
    reason=AdvisoryReason.WINTER_SPEED_FEW_VEHICLES,
    confidence=Confidence.INSUFFICIENT,
    interval=None,
    valid_for_s=600.0,
)
SUMMARY = KinematicSummary(
    values=tuple(0.01 * i for i in range(len(NEWEST_TABLE.kinematic))),
    table_digest=NEWEST_TABLE.digest,
    duration_s=31.0,
)


@dataclass
class Ether:
    """Frames are tokens; what they carry lies here, out of reach of the exchange."""

    frames_per_message: int = 1
    cargo: dict[bytes, tuple[int, int, Message]] = field(default_factory=dict)
    numbers: Iterator[int] = field(default_factory=count)

    def put(self, message: Message) -> tuple[bytes, ...]:
        number = next(self.numbers)
        names = [f"{number}/{i}".encode() for i in range(self.frames_per_message)]
        for name in names:
            self.cargo[name] = (number, self.frames_per_message, message)
        return tuple(names)


@dataclass
class TokenCodec:
    """One end's view of the ether."""

    ether: Ether
    have: dict[int, set[bytes]] = field(default_factory=dict)

    def frames_of(self, message: Message) -> tuple[bytes, ...]:
        return self.ether.put(message)

    def message_of(self, frame: bytes, *, now_s: float) -> Message | None:
        if frame not in self.ether.cargo:
            raise WireError(Reason.BAD_CHECKSUM, "spoiled")
        number, frames_count, message = self.ether.cargo[frame]
        seen = self.have.setdefault(number, set())
        if frame in seen:
            return None
        seen.add(frame)
        return message if len(seen) == frames_count else None


@dataclass
class Unit:
    """Answers what it understands, as long as its own frame budget lasts."""

    codec: TokenCodec
    section: RoadSection = BEND
    advice: Advisory = ADVICE
    outcomes: list[Outcome] = field(default_factory=lambda: [Accepted()])
    """Answers to one passage after the other; the last one stays."""
    frames_left_count: int = 8
    heard: list[Message] = field(default_factory=list)
    stored: dict[bytes, Outcome] = field(default_factory=dict)

    def answer(self, frame: bytes, now_s: float) -> list[bytes]:
        try:
            message = self.codec.message_of(frame, now_s=now_s)
        except WireError:
            return []
        if message is None:
            return []
        self.heard.append(message)
        replies: list[Message] = []
        if isinstance(message, Arrival):
            if message.known_map_version != self.section.version:
                replies.append(MapOffer(self.section, (NEWEST_TABLE.digest,)))
            replies.append(AdvisoryNotice(self.section.section_id, self.section.version, self.advice, issued_unix_s=0))
        if isinstance(message, Passage):
            outcome = self.stored.get(message.passage_id)
            if outcome is None:
                outcome = self.outcomes.pop(0) if len(self.outcomes) > 1 else self.outcomes[0]
                if isinstance(outcome, Accepted) or not outcome.reason.may_retry:
                    self.stored[message.passage_id] = outcome
            replies.append(Receipt(message.passage_id, outcome))
        frames = [frame for reply in replies for frame in self.codec.frames_of(reply)][: self.frames_left_count]
        self.frames_left_count -= len(frames)
        return frames


class Fate(Enum):
    """What the air does to one frame."""

    ARRIVES = "arrives"
    LOST = "lost"
    TWICE = "twice"
    LATE = "late"
    SPOILED = "spoiled"


@dataclass
class Air:
    """Plays an exchange against a unit; fates are taken one per frame, then everything arrives."""

    exchange: Exchange
    unit: Unit
    fates: Iterator[Fate]
    now_s: float = 0.0
    sent_count: int = 0
    queue: list[tuple[float, int, bool, bytes]] = field(default_factory=list)
    order: Iterator[int] = field(default_factory=count)

    def send(self, frames: Iterable[bytes], *, up: bool) -> None:
        for frame in frames:
            if up:
                self.sent_count += 1
            fate = next(self.fates, Fate.ARRIVES)
            delay_s = 3.0 if fate is Fate.LATE else 0.02
            if fate is Fate.LOST:
                continue
            carried = b"spoiled" if fate is Fate.SPOILED else frame
            for _ in range(2 if fate is Fate.TWICE else 1):
                heapq.heappush(self.queue, (self.now_s + delay_s, next(self.order), up, carried))

    def play(self, *, until: Stage | None = None, limit_s: float = 1000.0) -> None:
        """Let time pass until the exchange stands at a stage, a time is reached, or nothing can happen any more."""
        while self.exchange.stage is not until and self.now_s < limit_s:
            due_s = self.queue[0][0] if self.queue else float("inf")
            wake_s = self.exchange.wake_at_s
            if min(due_s, wake_s) > limit_s:
                return
            if due_s <= wake_s:
                self.now_s, _, up, frame = heapq.heappop(self.queue)
                if up:
                    self.send(self.unit.answer(frame, self.now_s), up=False)
                else:
                    self.exchange.receive(frame, now_s=self.now_s)
            else:
                self.now_s = max(self.now_s, wake_s)
                self.send(self.exchange.tick(now_s=self.now_s), up=True)
