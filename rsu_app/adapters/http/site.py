"""What the routes need from the unit, gathered by the composition root."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Annotated

from fastapi import Depends, Request

from rsu_app.adapters.http.access import OperatorAccess
from rsu_app.adapters.http.stream import StreamDesk
from rsu_app.gateway import FrameGateway
from rsu_app.intake import PassageIntake
from rsu_app.observability import Metrics
from rsu_app.operator_tokens import TokenScope
from rsu_app.usecases import Check, RoadSideUnit


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
        now_s: The machine's monotonic clock.
        access: Who may ask what.
        checks: What HTTP itself adds to the unit's readiness; for information, never required.
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
    now_s: Callable[[], float] = time.monotonic
    access: OperatorAccess = field(default_factory=OperatorAccess)
    checks: Callable[[], tuple[Check, ...]] = tuple


async def site_of(request: Request) -> Site:  # a plain function would be sent to a thread, at twice the cost of all
    """Return the site of the application that serves a request."""
    site: Site = request.app.state.site
    return site


def needs(scope: TokenScope) -> Callable[..., Awaitable[None]]:
    """Return what stands before a call that is for operators: it raises the problem, and counts it."""

    async def check(request: Request, site: Annotated[Site, Depends(site_of)]) -> None:
        problem = site.access.refusal(scope, request)
        if problem is not None:
            site.metrics.http_refusals.count(problem.reason)
            raise problem

    return check
