"""The web application, made by a function so that tests make as many as they like."""

from __future__ import annotations

from http import HTTPStatus
from typing import Any

import structlog
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.types import Receive, Scope, Send

from roadgrip.reasons import Reason
from rsu_app.adapters.http import frames, operations, sections
from rsu_app.adapters.http.access import SECURITY_SCHEMES
from rsu_app.adapters.http.front import Front
from rsu_app.adapters.http.guards import BodyGuard, RequestCounter
from rsu_app.adapters.http.problems import ProblemError, documented, problem_response, refusal
from rsu_app.adapters.http.site import Site

_log = structlog.get_logger("roadgrip")

_DESCRIPTION = """
What a road side unit says and hears over HTTP. Vehicles may send the very frames of the radio to `/v1/frames`;
people and other machines read JSON. SI units in every name. Refusals are `application/problem+json` with a `reason`.
"""
_TAGS = [
    {"name": "sections", "description": "Where the unit serves, and the maps."},
    {"name": "advice", "description": "What drivers are told, and the friction behind it."},
    {"name": "passages", "description": "What vehicles report."},
    {"name": "detections", "description": "Vehicles seen by loops and cameras."},
    {"name": "health", "description": "For operators."},
]


def create_app(site: Site) -> FastAPI:
    """Return the application of one unit."""
    app = _UnitApi(
        title="roadgrip road side unit",
        version=site.version,
        description=_DESCRIPTION,
        openapi_tags=_TAGS,
        license_info={"name": "Apache-2.0"},
        redoc_url=None,
        # The framework would promise its own words for a request that is not as documented.
        responses=documented(HTTPStatus.UNPROCESSABLE_ENTITY),
    )
    app.state.site = site
    app.include_router(sections.router)
    app.include_router(frames.router)
    app.include_router(operations.router)
    app.add_exception_handler(ProblemError, _on_problem)
    app.add_exception_handler(RequestValidationError, _on_invalid)
    app.add_exception_handler(HTTPException, _on_http)
    app.add_exception_handler(Exception, _on_bug)
    # The last one added is the first one asked: every request is counted, also those that the guard turns away.
    app.add_middleware(BodyGuard, body_limit_bytes=site.body_limit_bytes)
    app.add_middleware(
        RequestCounter, on_request=lambda route, status: site.metrics.http_requests.count(route, str(status))
    )
    app.front = Front(super(_UnitApi, app).__call__, site=site, on_bug=bug_response)
    return app


class _UnitApi(FastAPI):
    """The framework's application behind the front; its description also says how operators show that they are."""

    front: Front

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the front answer, or hand the request on."""
        await self.front(scope, receive, send)

    def openapi(self) -> dict[str, Any]:
        """Return the description of the interface."""
        document = super().openapi()
        document["components"]["securitySchemes"] = SECURITY_SCHEMES
        return document


async def _on_problem(_request: Request, error: Exception) -> Response:
    assert isinstance(error, ProblemError)  # noqa: S101 - the framework calls this for that class only
    return problem_response(error)


async def _on_invalid(request: Request, error: Exception) -> Response:
    """Return what is wrong with a request in words."""
    assert isinstance(error, RequestValidationError)  # noqa: S101 - same
    problems = [f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors()]
    return _malformed(request, "; ".join(problems[:5]))


def _malformed(request: Request, detail: str) -> Response:
    problem = refusal(Reason.MALFORMED, detail)
    site: Site = request.app.state.site
    if "section_id" in request.path_params and request.url.path.endswith("/passages"):
        label = site.metrics.section_label(request.path_params["section_id"])
        site.metrics.passages.labels(label, "rejected", problem.reason, "json").inc()
    return problem_response(problem)


async def _on_http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101 - same
    status = HTTPStatus(error.status_code)
    if status is HTTPStatus.BAD_REQUEST:  # a body that is no text, or too deep to be read
        return _malformed(request, str(error.detail))
    response = problem_response(ProblemError(_SLUGS.get(status, "refused"), status, str(error.detail)))
    response.headers.update(error.headers or {})
    return response


_SLUGS = {
    HTTPStatus.NOT_FOUND: "not_found",
    HTTPStatus.METHOD_NOT_ALLOWED: "method_not_allowed",
}


async def _on_bug(request: Request, error: Exception) -> Response:
    return bug_response(request.url.path, error)


def bug_response(path: str, error: Exception) -> Response:
    """Return 500 without inner details; the log has them."""
    _log.error("bug", path=path, error=repr(error))
    return problem_response(
        ProblemError("internal", HTTPStatus.INTERNAL_SERVER_ERROR, "the unit failed; the passage was not accepted")
    )
