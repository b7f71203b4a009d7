"""The route for vehicles over cellular: the very frames of the radio, several in one body."""

from __future__ import annotations

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from starlette.types import Scope

from roadgrip.errors import WireError
from roadgrip.frames import iter_frames, join_frames
from rsu_app.adapters.http.problems import ProblemError, documented, refusal
from rsu_app.adapters.http.site import Site, site_of
from rsu_app.gateway import SOMEBODY, OutFrames, Sender

FRAMES_MEDIA_TYPE = "application/vnd.roadgrip.frames"
FRAMES_PATH = "/v1/frames"
VIA = "http"

router = APIRouter()

_BINARY = {"schema": {"type": "string", "format": "binary"}}


@router.post(
    FRAMES_PATH,
    tags=["passages"],
    summary="The frames of the radio, over cellular",
    response_class=Response,
    responses={
        200: {
            "description": "The frames the unit answers with, one after the other; an empty body if there are none. "
            "A refused message is answered by a RECEIPT with its reason, as over the radio.",
            "content": {FRAMES_MEDIA_TYPE: _BINARY},
        },
        **documented(
            HTTPStatus.UNSUPPORTED_MEDIA_TYPE, HTTPStatus.UNPROCESSABLE_ENTITY, HTTPStatus.REQUEST_ENTITY_TOO_LARGE
        ),
    },
    openapi_extra={"requestBody": {"required": True, "content": {FRAMES_MEDIA_TYPE: _BINARY}}},
)
async def exchange_frames(request: Request, site: Annotated[Site, Depends(site_of)]) -> Response:
    """Handle each frame as if it had come over the radio, in order; an answer leaves after its commit."""
    media_type = request.headers.get("content-type", "").partition(";")[0].strip()
    if media_type != FRAMES_MEDIA_TYPE:
        raise ProblemError(
            "unsupported_media_type", HTTPStatus.UNSUPPORTED_MEDIA_TYPE, f"the body must be {FRAMES_MEDIA_TYPE}"
        )
    return await frames_answered(site, await request.body(), sender=sender_of(request.scope))


def sender_of(scope: Scope) -> Sender:
    """Return who sends a request. Each may come by another port, so only the host tells senders apart."""
    client = scope.get("client")
    return Sender(client[0]) if client else SOMEBODY


async def frames_answered(site: Site, body: bytes, *, sender: Sender) -> Response:
    """Return the frames that the unit answers with to those of a body.

    Args:
        site: The unit.
        body: Frames one after the other, or rubbish.
        sender: Who sends them.

    Raises:
        ProblemError: The body is not frames; nothing in it was looked at.
    """
    try:
        # The whole body before the first frame: a body that is broken behind it changes nothing.
        datagrams = tuple(iter_frames(body))
    except WireError as error:
        site.metrics.frames_dropped.count(VIA, error.reason.value)
        raise refusal(error.reason, error.detail) from error
    # Each is heard before any of them is settled: a body waits for one commit, and not for one per passage.
    heard = [site.gateway.take(datagram, via=VIA, sender=sender) for datagram in datagrams]
    settled = [None if taken.passage is None else site.gateway.settling(taken.passage, via=VIA) for taken in heard]
    answers: list[OutFrames] = []
    for taken, receipt in zip(heard, settled, strict=True):
        answers += taken.replies if receipt is None else await receipt
    for message in answers:
        site.metrics.frames_sent.count(VIA, message.name, by=len(message.frames))
    return Response(join_frames(f for m in answers for f in m.frames), media_type=FRAMES_MEDIA_TYPE)
