"""The route for vehicles over cellular: the very frames of the radio, several in one body."""

from __future__ import annotations

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response

from roadgrip.errors import WireError
from roadgrip.frames import iter_frames, join_frames
from rsu_app.adapters.http.problems import ProblemError, documented, refusal
from rsu_app.adapters.http.site import Site, site_of
from rsu_app.gateway import OutFrames

FRAMES_MEDIA_TYPE = "application/vnd.roadgrip.frames"
VIA = "http"

router = APIRouter()

_BINARY = {"schema": {"type": "string", "format": "binary"}}


@router.post(
    "/v1/frames",
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
    try:
        # The whole body before the first frame: a body that is broken behind it changes nothing.
        datagrams = tuple(iter_frames(await request.body()))
    except WireError as error:
        site.metrics.frames_dropped.labels(VIA, error.reason.value).inc()
        raise refusal(error.reason, error.detail) from error
    answers: list[OutFrames] = []
    for datagram in datagrams:
        taken = site.gateway.take(datagram, via=VIA)
        answers += taken.replies
        if taken.passage is not None:
            answers += await site.gateway.settle(taken.passage, via=VIA)
    for message in answers:
        site.metrics.frames_sent.labels(VIA, message.name).inc(len(message.frames))
    body = join_frames(frame for message in answers for frame in message.frames)
    return Response(body, media_type=FRAMES_MEDIA_TYPE)
