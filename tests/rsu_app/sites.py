"""A whole unit without processes, sockets or disks: real use cases, gateway and web application over fakes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import httpx
import numpy as np
from fastapi import FastAPI

from bench.certified import claims_for
from roadgrip.exchange import FROM_UNIT, ExchangeLedger, message_of
from roadgrip.frames import Reassembler, exchange_id_of, parse_frame, section_key_of, split_into_frames
from roadgrip.records import Message, Passage
from roadgrip.section import RoadSection
from roadgrip.signing import NO_CLAIMS, Signer, Verifier
from roadgrip.trust import Trust
from roadgrip.wire import encode_message, kind_of
from rsu_app.adapters.http.app import create_app
from rsu_app.adapters.http.site import Broadcast, Site
from rsu_app.adapters.http.stream import StreamDesk
from rsu_app.gateway import FrameGateway, OutFrames
from rsu_app.intake import PassageIntake
from rsu_app.observability import Metrics
from rsu_app.sender_guards import SenderGuards
from rsu_app.signatures import SignatureMode, Signatures
from rsu_app.usecases import RoadSideUnit, UnitLimits
from tests.rsu_app.fakes import NOON_UNIX_S, FakeClock, FakeModel, FakeStore, make_section


@dataclass
class UnitUnderTest:
    section: RoadSection
    store: FakeStore
    clock: FakeClock
    model: FakeModel | None
    unit: RoadSideUnit
    metrics: Metrics
    intake: PassageIntake
    gateway: FrameGateway
    site: Site
    broadcasts: list[str]

    @property
    def app(self) -> FastAPI:
        return create_app(self.site)

    def client(self, app: FastAPI | None = None) -> httpx.AsyncClient:
        transport = httpx.ASGITransport(app=app or self.app, raise_app_exceptions=False)
        return httpx.AsyncClient(transport=transport, base_url="http://unit")

    def count(self, metric: str, **labels: str) -> float:
        """Return the value of a series; zero if it does not exist."""
        return self.metrics.registry.get_sample_value(metric, labels) or 0.0


def make_unit(
    *,
    section: RoadSection | None = None,
    model: FakeModel | bool = True,
    in_flight_limit_count: int = 64,
    subscribers_count: int = 8,
    refusals_per_s: float = 100.0,
    signer: Signer | None = None,
    verifier: Verifier | None = None,
    mode: SignatureMode = SignatureMode.REQUIRED,
    broadcast: bool = True,
    detections_count: int = -1,
    now_s: Callable[[], float] | None = None,
    guards: SenderGuards | None = None,
    **site_changes: Any,
) -> UnitUnderTest:
    section = section or make_section()
    store, clock = FakeStore(), FakeClock()
    chosen = FakeModel() if model is True else model or None
    metrics = Metrics(version="0", section_ids=[section.section_id])
    unit = RoadSideUnit(
        sections=[section],
        store=store,
        model=chosen,
        clock=clock,
        limits=UnitLimits(subscribers_count=subscribers_count),
    )
    intake = PassageIntake(unit, metrics=metrics, in_flight_limit_count=in_flight_limit_count)
    gateway = FrameGateway(
        unit=unit,
        intake=intake,
        ledger=ExchangeLedger(limit_count=1000, timeout_s=3600.0),
        metrics=metrics,
        now_s=now_s or clock.monotonic_s,
        random_bytes=np.random.default_rng(1).bytes,
        refusals_per_s=refusals_per_s,
        signatures=Signatures(
            Trust(() if signer is None else (signer,), verifier),
            modes={} if verifier is None else {"udp": mode, "http": mode},
            unix_s=lambda: int(clock.unix_s()) if unit.clock_plausible else None,
        ),
        guards=guards,
    )
    broadcasts: list[str] = []

    def send(section_id: str) -> Broadcast:
        broadcasts.append(section_id)
        frames = [frame for out in gateway.guidance(section_id) for frame in out.frames]
        return Broadcast(frames_count=len(frames), bytes_count=sum(map(len, frames)))

    async def observe() -> None:
        gateway.observe()

    site = Site(
        unit=unit,
        intake=intake,
        gateway=gateway,
        broadcast=send if broadcast else None,
        detection_allowed=lambda: detections_count < 0 or len(broadcasts) < detections_count,
        observe=observe,
        streams=StreamDesk(metrics),
        metrics=metrics,
        version="0",
        signatures_required=verifier is not None and mode is SignatureMode.REQUIRED,
    )
    return UnitUnderTest(
        section, store, clock, chosen, unit, metrics, intake, gateway, replace(site, **site_changes), broadcasts
    )


def passage_json(passage: Passage, **changes: Any) -> dict[str, Any]:
    summary = passage.summary
    return {
        "passage_id": passage.passage_id.hex(),
        "map_version": passage.map_version,
        "table_digest": summary.table_digest,
        "duration_s": summary.duration_s,
        "age_s": passage.age_s,
        "quality": int(summary.quality),
        "values": list(summary.values),
    } | changes


def json_text(content: dict[str, Any]) -> str:
    """JSON as careless senders write it: NaN and infinity included."""
    return json.dumps(content, allow_nan=True)


def frames_of(message: Message, *, passage_id: bytes, section_id: str, signer: Signer | None = None) -> list[bytes]:
    return list(
        split_into_frames(
            kind_of(message),
            encode_message(
                message,
                signer=signer,
                exchange_id=exchange_id_of(passage_id),
                claims=NO_CLAIMS
                if signer is None
                else claims_for(message, section_id=section_id, now_unix_s=int(NOON_UNIX_S)),
            ),
            exchange_id=exchange_id_of(passage_id),
            section_key=section_key_of(section_id),
        )
    )


def frame_of_passage(passage: Passage, *, signer: Signer | None = None) -> bytes:
    (frame,) = frames_of(passage, passage_id=passage.passage_id, section_id=passage.section_id, signer=signer)
    return frame


def read_frames(frames: list[bytes], *, verifier: Verifier | None = None) -> list[Message]:
    """Read frames as a vehicle does."""
    reassembler = Reassembler(limit_count=100, limit_bytes=1_000_000, timeout_s=10.0)
    found = []
    for frame in frames:
        complete = reassembler.offer(parse_frame(frame), source="unit", now_s=0.0)
        if complete is not None:
            received = message_of(
                complete,
                expected=FROM_UNIT,
                verifier=verifier,
                required=verifier is not None,
                now_unix_s=NOON_UNIX_S,
            )
            found.append(received.message)
    return found


def read_replies(replies: tuple[OutFrames, ...], *, verifier: Verifier | None = None) -> list[Message]:
    return read_frames([frame for out in replies for frame in out.frames], verifier=verifier)


async def radio(under_test: UnitUnderTest, datagram: bytes, *, verifier: Verifier | None = None) -> list[Message]:
    """Send a datagram and return everything the unit answers."""
    taken = under_test.gateway.take(datagram, via="udp")
    replies = taken.replies
    if taken.passage is not None:
        replies += await under_test.gateway.settle(taken.passage, via="udp")
    return read_replies(replies, verifier=verifier)
