"""Routes for operators: health, metrics, and the page that people find at `/`."""

from __future__ import annotations

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from fastapi.responses import HTMLResponse
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4

from roadgrip.records import Rejected
from rsu_app.adapters.http.access import OPERATOR_PROBLEMS, OPERATORS_ONLY
from rsu_app.adapters.http.models import ConditionModel, LivenessModel, ReadinessModel
from rsu_app.adapters.http.page import PAGE_HEADERS, SectionView, UnitState, status_page
from rsu_app.adapters.http.site import Site, needs, site_of
from rsu_app.operator_tokens import TokenScope
from rsu_app.usecases import Readiness

router = APIRouter()

SiteOf = Annotated[Site, Depends(site_of)]


@router.get("/health/live", tags=["health"], summary="The process answers")
async def live(site: SiteOf) -> LivenessModel:
    """Return at once, whatever else is broken."""
    return LivenessModel(version=site.version)


@router.get(
    "/health/ready",
    tags=["health"],
    summary="The unit does its whole job",
    responses={
        503: {"model": ReadinessModel, "description": "It does not; each condition says why."},
        **OPERATOR_PROBLEMS,
    },
    openapi_extra=OPERATORS_ONLY,
    dependencies=[Depends(needs(TokenScope.HEALTH))],
)
async def ready(site: SiteOf, response: Response) -> ReadinessModel:
    """Ask the model for its golden vectors, the store for a write and the clock for the year; 503 if one fails."""
    readiness = await observed_readiness(site)
    if not readiness.ready:
        response.status_code = HTTPStatus.SERVICE_UNAVAILABLE
    return ReadinessModel(
        ready=readiness.ready,
        conditions=tuple(
            ConditionModel(name=c.name, ok=c.ok, required=c.required, detail=c.detail) for c in readiness.checks
        ),
    )


@router.get(
    "/metrics",
    tags=["health"],
    summary="Metrics for Prometheus",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}, **OPERATOR_PROBLEMS},
    openapi_extra=OPERATORS_ONLY,
    dependencies=[Depends(needs(TokenScope.METRICS))],
)
async def metrics(site: SiteOf) -> Response:
    """Return all metrics in the text format of Prometheus."""
    await site.observe()
    return Response(site.metrics.exposition(), media_type=CONTENT_TYPE_PLAIN_0_0_4)


@router.get("/", include_in_schema=False)
async def page(site: SiteOf, request: Request) -> HTMLResponse:
    """Return the page for people; an operator also sees whether the unit is ready, and what runs on it."""
    state = None
    if site.access.refusal(TokenScope.HEALTH, request) is None:
        readiness = await observed_readiness(site)
        problems = tuple(f"{c.name}: {c.detail}" for c in readiness.checks if c.required and not c.ok)
        state = UnitState(site.version, problems)
    views = []
    for section_id in site.unit.section_ids:
        offer, advisory = site.unit.map_offer(section_id), site.unit.current_advisory(section_id)
        friction = site.unit.current_friction(section_id)
        if not (isinstance(offer, Rejected) or isinstance(advisory, Rejected) or isinstance(friction, Rejected)):
            views.append(SectionView(offer.section, advisory, friction))
    return HTMLResponse(status_page(views, state=state), headers=PAGE_HEADERS)


async def observed_readiness(site: Site) -> Readiness:
    """Return the unit's readiness, and show it in the metric."""
    readiness = await site.unit.readiness()
    site.metrics.ready.set(readiness.ready)
    return Readiness((*readiness.checks, *site.checks()))
