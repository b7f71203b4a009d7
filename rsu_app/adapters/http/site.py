"""What the routes need from the unit, gathered by the composition root."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from fastapi import Request

from rsu_app.adapters.http.stream import StreamDesk
from rsu_app.gateway import FrameGateway
from rsu_app.intake import PassageIntake
from rsu_app.observability import Metrics
from rsu_app.usecases import RoadSideUnit


@dataclass(frozen=True, slots=True)
class Broadcast:
    """What was sent to everybody in reach."""

    frames_count: int
    bytes_count: int


@dataclass(frozen=True, slots=True)
class Site:
    """One unit as HTTP sees it.

    Attributes:
        unit: Answers.
        intake: Takes passages.
        gateway: Takes frames.
        broadcast: Sends map and advisory of a section to everybody in reach; None where there is nothing to send
            with.
        observe: Brings the gauges up to date before they are read.
        detection_allowed: Whether one more detection may be broadcast now; counts it if so.
        streams: Knows the open event streams.
        metrics: Counts.
        version: Of the software.
        signatures_required: Then a passage as JSON, which cannot be signed, is refused.
        body_limit_bytes: Largest request body.
        stream_heartbeat_s: How often a silent stream says so.
    """

    unit: RoadSideUnit
    intake: PassageIntake
    gateway: FrameGateway
    broadcast: Callable[[str], Broadcast] | None
    detection_allowed: Callable[[], bool]
    observe: Callable[[], Awaitable[None]]
    streams: StreamDesk
    metrics: Metrics
    version: str
    signatures_required: bool = False
    body_limit_bytes: int = 65_536
    stream_heartbeat_s: float = 15.0


async def site_of(request: Request) -> Site:  # a plain function would be sent to a thread, at twice the cost of all
    """Return the site of the application that serves a request."""
    site: Site = request.app.state.site
    return site
