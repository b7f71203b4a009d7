"""Vehicles without end, over radio and cellular, that remember which of their passages were acknowledged."""

from __future__ import annotations

import contextlib
import http.client
import itertools
import json
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from roadgrip.errors import WireError
from roadgrip.features import NEWEST_TABLE
from roadgrip.frames import exchange_id_of, unread_passage_id
from roadgrip.records import Accepted, AdvisoryNotice, Arrival, Cookie, Message, Passage, Receipt, Rejected
from roadgrip.section import RoadSection
from roadgrip.section_file import section_from_json
from roadgrip.wire import rounded_to_wire
from tests.rsu_app.fakes import make_passage
from tests.rsu_app.sites import frame_of_passage, frames_of, passage_json, read_frames
from tests.system.daemons import Daemon

SECTION_ID = "long-turn"
PASSAGES_PATH = f"/v1/sections/{SECTION_ID}/passages"
FRAMES_TYPE = "application/vnd.roadgrip.frames"
IN_FLIGHT_COUNT = 48
AGAIN_AFTER_S = 2.0
"""An unanswered frame is sent again after this, as vehicles do."""
PAUSE_AFTER_REFUSAL_S = 0.01
_KURTOSIS = [feature.name for feature in NEWEST_TABLE.kinematic].index("steer_kurtosis")


def section_of(daemon: Daemon) -> RoadSection:
    """Return the section that a unit serves."""
    return section_from_json(daemon.client.get(f"/v1/sections/{SECTION_ID}/map").text)


def numbered_passage(template: Passage, number: int) -> Passage:
    """Return a passage of its own for every number below a million, made fast enough to keep a unit under pressure."""
    values = list(template.summary.values)
    values[_KURTOSIS] = 2.0 + number * 1e-5
    # Both halves differ: the first names the exchange.
    # As the air rounds it: over cellular the very same is sent again.
    return rounded_to_wire(
        replace(
            template,
            passage_id=number.to_bytes(8, "big") * 2,
            summary=replace(template.summary, values=tuple(values)),
        )
    )


@dataclass
class Traffic:
    """What vehicles sent and what they were told.

    Attributes:
        section: Where they drive.
        first_number: Passages are numbered from here.
        moment: Asked when a receipt comes; kept with it.
        sent: By id, in the order of sending.
        acknowledged: Ids, each with the moment of its receipt.
        refused: How often each reason was given.
        strange: Answers that should not be.
    """

    section: RoadSection
    first_number: int
    moment: Callable[[], int] = lambda: 0
    sent: dict[bytes, Passage] = field(default_factory=dict)
    acknowledged: dict[bytes, int] = field(default_factory=dict)
    refused: Counter[str] = field(default_factory=Counter)
    strange: list[str] = field(default_factory=list)
    over: threading.Event = field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        self._template = make_passage(self.section, mu=0.4)
        self._numbers: Iterator[int] = itertools.count(self.first_number)

    @property
    def last_number(self) -> int:
        """The number that the next passage would have."""
        return self.first_number + len(self.sent)

    def next_passage(self) -> Passage:
        """Return a passage that nobody has sent before."""
        passage = numbered_passage(self._template, next(self._numbers))
        self.sent[passage.passage_id] = passage
        return passage

    def note(self, receipt: Receipt) -> bool:
        """Remember what a vehicle was told; return whether its passage is done with."""
        if receipt.passage_id not in self.sent:
            self.strange.append(f"a receipt for {receipt.passage_id.hex()}, which nobody sent: {receipt.outcome}")
            return False
        match receipt.outcome:
            case Accepted():
                self.acknowledged.setdefault(receipt.passage_id, self.moment())
                return True
            case Rejected(reason=reason):
                self.refused[reason.value] += 1
                if not reason.may_retry:
                    self.strange.append(f"a good passage was refused: {receipt.outcome}")
                return not reason.may_retry

    @contextmanager
    def driving(self, daemon: Daemon, *, http: bool = True, udp: bool = True) -> Iterator[None]:
        """Send from three threads until the end, or until the unit is gone."""
        senders = [self._radio] * udp + [self._frames, self._json] * http
        threads = [threading.Thread(target=sender, args=(daemon.ports,), daemon=True) for sender in senders]
        self.over.clear()
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            self.over.set()
            for thread in threads:
                thread.join(30.0)
            if any(thread.is_alive() for thread in threads):
                self.strange.append("a sender did not come to an end")

    def wait_for(self, count: int, *, seconds: float = 30.0) -> bool:
        """Return whether so many passages have been acknowledged in time."""
        give_up_s = time.monotonic() + seconds
        while len(self.acknowledged) < count and time.monotonic() < give_up_s:
            time.sleep(0.002)
        return len(self.acknowledged) >= count

    def _radio(self, ports: tuple[int, int]) -> None:
        waiting: dict[bytes, float] = {}
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.connect(("127.0.0.1", ports[1]))
            link.settimeout(0.05)
            while not self.over.is_set():
                now_s = time.monotonic()
                while len(waiting) < IN_FLIGHT_COUNT:
                    waiting[self.next_passage().passage_id] = 0.0
                for passage_id, again_at_s in list(waiting.items()):
                    if again_at_s <= now_s:
                        with contextlib.suppress(ConnectionError):
                            link.send(frame_of_passage(self.sent[passage_id]))
                        waiting[passage_id] = now_s + AGAIN_AFTER_S
                for receipt in _heard(link):
                    if self.note(receipt):
                        waiting.pop(receipt.passage_id, None)
                    elif receipt.passage_id in waiting:
                        waiting[receipt.passage_id] = time.monotonic() + PAUSE_AFTER_REFUSAL_S

    def _frames(self, ports: tuple[int, int]) -> None:
        def ask(link: http.client.HTTPConnection, passage: Passage) -> Receipt | None:
            link.request("POST", "/v1/frames", frame_of_passage(passage), {"content-type": FRAMES_TYPE})
            return receipt_of(link.getresponse().read())

        self._cellular(ports, ask)

    def _json(self, ports: tuple[int, int]) -> None:
        def ask(link: http.client.HTTPConnection, passage: Passage) -> Receipt | None:
            body = json.dumps(passage_json(passage))
            link.request("POST", PASSAGES_PATH, body, {"content-type": "application/json"})
            answer = link.getresponse()
            said = json.loads(answer.read())
            if answer.status == http.client.OK:
                return Receipt(passage.passage_id, Accepted())
            self.refused[said.get("reason", str(answer.status))] += 1
            time.sleep(PAUSE_AFTER_REFUSAL_S)
            return None

        self._cellular(ports, ask)

    def _cellular(
        self, ports: tuple[int, int], ask: Callable[[http.client.HTTPConnection, Passage], Receipt | None]
    ) -> None:
        link = http.client.HTTPConnection("127.0.0.1", ports[0], timeout=20.0)
        passage = self.next_passage()
        while not self.over.is_set():
            try:
                receipt = ask(link, passage)
            except (OSError, http.client.HTTPException):
                # The unit is gone; nothing was said, so nothing was acknowledged.
                link.close()
                self.over.wait(0.02)
                continue
            if receipt is not None and self.note(receipt):
                passage = self.next_passage()
        link.close()


def again(daemon: Daemon, passage: Passage, traffic: Traffic) -> bool:
    """Send a passage over cellular, as a vehicle does whose receipt was lost; return whether it is accepted."""
    headers = {"content-type": FRAMES_TYPE}
    content = frame_of_passage(replace(passage, age_s=5.0))
    receipt = receipt_of(daemon.client.post("/v1/frames", content=content, headers=headers).content)
    return receipt is not None and traffic.note(receipt)


def heard_after(daemon: Daemon, message: Arrival, *, section: RoadSection) -> list[Message]:
    """Return what a unit answers to a vehicle that arrives, by radio."""
    heard: list[bytes] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link, contextlib.suppress(TimeoutError, ConnectionError):
        link.connect(("127.0.0.1", daemon.udp_port))
        link.settimeout(2.0)
        link.send(_frame_of(message, section))
        while not any(isinstance(known, AdvisoryNotice) for known in read_frames(heard)):
            heard.append(link.recv(2000))
            for known in read_frames(heard[-1:]):
                if isinstance(known, Cookie):
                    link.send(_frame_of(replace(message, cookie=known.cookie), section))
    return read_frames(heard)


def _frame_of(message: Arrival, section: RoadSection) -> bytes:
    (frame,) = frames_of(message, passage_id=message.passage_id, section_id=section.section_id)
    return frame


def receipt_of(frame: bytes) -> Receipt | None:
    """Return the receipt that a frame holds, for the passage it means: one of ours, refused unread, is named in "
    "half."""
    try:
        (message,) = read_frames([frame])
    except (WireError, ValueError):
        return None
    if not isinstance(message, Receipt):
        return None
    exchange_id = exchange_id_of(message.passage_id)
    if message.passage_id == unread_passage_id(exchange_id):
        return replace(message, passage_id=exchange_id * 2)
    return message


def _heard(link: socket.socket) -> Iterator[Receipt]:
    """Yield the receipts that have come, after waiting for the first."""
    try:
        frames = [link.recv(2000)]
        link.setblocking(False)
        while True:
            try:
                frames.append(link.recv(2000))
            except BlockingIOError:
                break
    except (TimeoutError, ConnectionError):
        return
    finally:
        link.settimeout(0.05)
    for frame in frames:
        receipt = receipt_of(frame)
        if receipt is not None:
            yield receipt
