"""Routes about sections: map, advisory, friction, passages, detections."""

from __future__ import annotations

from functools import lru_cache
from http import HTTPStatus
from typing import Annotated, TypeVar

import structlog
from fastapi import APIRouter, Depends, Header, Path, Query, Request, Response

from roadgrip.reasons import Reason
from roadgrip.records import AdvisoryNotice, MapOffer, Rejected
from roadgrip.section import RoadSection
from roadgrip.section_file import section_to_json
from rsu_app.adapters.http.access import OPERATOR_PROBLEMS, OPERATORS_ONLY
from rsu_app.adapters.http.frames import sender_of
from rsu_app.adapters.http.models import (
    AdvisoryModel,
    BroadcastModel,
    DetectionModel,
    FrictionModel,
    PassageModel,
    ReceiptModel,
    SectionModel,
    SectionsModel,
    advisory_model,
    interval_model,
    receipt_model,
    section_model,
)
from rsu_app.adapters.http.problems import STATUS_OF_REASON, ProblemError, documented, refusal
from rsu_app.adapters.http.site import Site, needs, site_of
from rsu_app.gateway import Sender
from rsu_app.operator_tokens import TokenScope

_log = structlog.get_logger("roadgrip")

T = TypeVar("T")

CBOR_MEDIA_TYPE = "application/cbor"
TABLE_DIGESTS_HEADER = "Roadgrip-Table-Digests"

PREFIX = "/v1/sections"
ADVISORY_PATH = PREFIX + "/{section_id}/advisory"
MAP_PATH = PREFIX + "/{section_id}/map"
PASSAGES_PATH = PREFIX + "/{section_id}/passages"
MAPS_KEPT_COUNT = 64

router = APIRouter(prefix=PREFIX)

SiteOf = Annotated[Site, Depends(site_of)]
SectionId = Annotated[str, Path(max_length=64, description="Id of a section the unit serves.", examples=["long-turn"])]

_NO_SECTION = documented(HTTPStatus.NOT_FOUND)


@router.get("", tags=["sections"], summary="The sections this unit serves")
async def list_sections(
    site: SiteOf,
    bbox: Annotated[
        str | None,
        Query(
            description="Only sections with a GNSS anchor inside `min_lon,min_lat,max_lon,max_lat` (degrees, WGS 84).",
            examples=["10.1,61.5,10.3,61.6"],
            max_length=200,
        ),
    ] = None,
) -> SectionsModel:
    """Return each section with its map version and where to go from there."""
    box = None if bbox is None else _box(bbox)
    offers = (_known(site.unit.map_offer(section_id)) for section_id in site.unit.section_ids)
    return SectionsModel(
        sections=tuple(_listed(offer) for offer in offers if box is None or _touches(offer.section, box))
    )


@router.get("/{section_id}", tags=["sections"], summary="One section", responses=_NO_SECTION)
async def one_section(site: SiteOf, section_id: SectionId) -> SectionModel:
    """Return the section as the listing shows it."""
    return _listed(_known(site.unit.map_offer(section_id)))


@router.get(
    MAP_PATH.removeprefix(PREFIX),
    tags=["sections"],
    summary="The map, for people or for vehicles",
    response_class=Response,
    responses={
        200: {
            "description": "The section file; with `Accept: application/cbor` the message MAP as vehicles get it.",
            "content": {"application/json": {"schema": {"type": "object"}}, CBOR_MEDIA_TYPE: {}},
        },
        304: {"description": "The map is the one named in `If-None-Match`."},
        **_NO_SECTION,
    },
)
async def section_map(
    site: SiteOf,
    section_id: SectionId,
    accept: Annotated[str, Header()] = "application/json",
    if_none_match: Annotated[str, Header()] = "",
) -> Response:
    """Return the map. `ETag` is its version, so that a client who has it is told so in a few bytes."""
    offer = _known(site.unit.map_offer(section_id))
    as_cbor = CBOR_MEDIA_TYPE in accept
    # Two spellings of one map need two tags (RFC 9110, section 8.8.3).
    etag = f'"{offer.section.version}{".cbor" if as_cbor else ""}"'
    headers = {
        "ETag": etag,
        "Cache-Control": "no-cache",
        "Vary": "Accept",
        TABLE_DIGESTS_HEADER: ", ".join(offer.table_digests),
    }
    if etag in if_none_match or if_none_match.strip() == "*":
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    if as_cbor:
        return Response(site.gateway.map_message(offer), media_type=CBOR_MEDIA_TYPE, headers=headers)
    return Response(_map_json(offer.section), media_type="application/json", headers=headers)


@router.get(
    ADVISORY_PATH.removeprefix(PREFIX), tags=["advice"], summary="What drivers are told now", responses=_NO_SECTION
)
async def section_advisory(site: SiteOf, section_id: SectionId) -> AdvisoryModel:
    """Return speed, reason, confidence and the friction behind it."""
    return _advice(site, _known(site.unit.map_offer(section_id)).section, _known(site.unit.advisory_notice(section_id)))


@router.get("/{section_id}/friction", tags=["advice"], summary="The friction interval", responses=_NO_SECTION)
async def section_friction(site: SiteOf, section_id: SectionId) -> FrictionModel:
    """Return the interval from worn to new tyres; null while no vehicle is behind it."""
    notice = _known(site.unit.advisory_notice(section_id))
    return FrictionModel(
        section_id=section_id,
        map_version=notice.map_version,
        confidence=notice.advisory.confidence,
        interval=interval_model(_known(site.unit.current_friction(section_id))),
    )


@router.get(
    "/{section_id}/friction/stream",
    tags=["advice"],
    summary="Advice and friction as they change",
    response_class=Response,
    responses={
        200: {
            "description": "Server-sent events named `advisory`, each with the JSON of `/advisory`: the one that "
            "stands, then one for each change. A comment line shows that a silent stream is alive.",
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
        },
        **documented(HTTPStatus.NOT_FOUND, HTTPStatus.SERVICE_UNAVAILABLE),
    },
)
async def friction_stream(site: SiteOf, section_id: SectionId) -> Response:
    """Return a stream that lasts until the client leaves."""
    section = _known(site.unit.map_offer(section_id)).section
    return site.streams.response(
        _known(site.unit.subscribe(section_id)),
        encode=lambda notice: _advice(site, section, notice).model_dump_json(),
        heartbeat_s=site.stream_heartbeat_s,
    )


@router.post(
    PASSAGES_PATH.removeprefix(PREFIX),
    tags=["passages"],
    summary="Report a passage",
    responses=documented(*STATUS_OF_REASON.values()),
)
async def report_passage(request: Request, site: SiteOf, section_id: SectionId, passage: PassageModel) -> ReceiptModel:
    """Return the receipt, after the passage is on the disk. Sending it twice changes nothing and answers the same.

    The receipt never holds the estimate. A passage that is stored but not counted says why in `not_counted`.
    """
    return await passage_answered(site, section_id, passage, sender=sender_of(request.scope))


async def passage_answered(site: Site, section_id: str, passage: PassageModel, *, sender: Sender) -> ReceiptModel:
    """Return the receipt of a passage, as `report_passage` does.

    Raises:
        ProblemError: It is refused.
    """
    record = passage.to_record(section_id)
    early: Rejected | None = None
    if not site.gateway.is_allowed(sender):
        early = Rejected(Reason.RATE_LIMITED, "more passages a second than one address may send")
    elif site.signatures_required:
        early = Rejected(Reason.UNSIGNED, "JSON cannot be signed; send frames to /v1/frames")
    if early is not None:
        site.intake.note(record, early, via="json")
        raise refusal(early.reason, early.detail)
    answer = await site.intake.receive(record, via="json")
    if isinstance(answer, Rejected):
        raise refusal(answer.reason, answer.detail)
    return receipt_model(record.passage_id, answer)


@router.post(
    "/{section_id}/detections",
    tags=["detections"],
    summary="A loop or a camera reports a vehicle",
    responses=documented(HTTPStatus.NOT_FOUND, HTTPStatus.SERVICE_UNAVAILABLE) | OPERATOR_PROBLEMS,
    openapi_extra=OPERATORS_ONLY,
    dependencies=[Depends(needs(TokenScope.DETECTIONS))],
)
async def report_detection(site: SiteOf, section_id: SectionId, detection: DetectionModel) -> BroadcastModel:
    """Broadcast map and advisory, for vehicles that do not know where they are."""
    _known(site.unit.map_offer(section_id))
    site.metrics.detections.labels(section_id).inc()
    if site.broadcast is None:
        raise ProblemError(
            "no_broadcast", HTTPStatus.SERVICE_UNAVAILABLE, "udp.broadcast_host is not set: there is nobody to send to"
        )
    if not site.detection_allowed():
        raise refusal(Reason.BUSY, "map and advisory were sent to all a moment ago; so many a second and no more")
    sent = site.broadcast(section_id)
    _log.info("detection", section=section_id, source=detection.source, frames_count=sent.frames_count)
    return BroadcastModel(frames_sent_count=sent.frames_count, bytes_sent_count=sent.bytes_count)


def _known(answer: T | Rejected) -> T:
    """Return the answer, or leave the route with the problem that a refusal is."""
    if isinstance(answer, Rejected):
        raise refusal(answer.reason, answer.detail)
    return answer


@lru_cache(MAPS_KEPT_COUNT)
def _map_json(section: RoadSection) -> str:
    return section_to_json(section)  # written once for each map: it takes longer than everything else about a request


def _listed(offer: MapOffer) -> SectionModel:
    return section_model(offer.section, offer.table_digests)


def _advice(site: Site, section: RoadSection, notice: AdvisoryNotice) -> AdvisoryModel:
    return advisory_model(section, notice, _known(site.unit.current_friction(section.section_id)))


def _box(bbox: str) -> tuple[float, float, float, float]:
    try:
        west, south, east, north = (float(part) for part in bbox.split(","))
    except ValueError:
        raise refusal(Reason.MALFORMED, "bbox is min_lon,min_lat,max_lon,max_lat") from None
    if not (-180.0 <= west <= east <= 180.0 and -90.0 <= south <= north <= 90.0):
        raise refusal(Reason.OUT_OF_RANGE, "bbox must ascend, longitudes within 180 and latitudes within 90 degrees")
    return west, south, east, north


def _touches(section: RoadSection, box: tuple[float, float, float, float]) -> bool:
    west, south, east, north = box
    return any(west <= a.lon_deg <= east and south <= a.lat_deg <= north for a in section.anchors)
