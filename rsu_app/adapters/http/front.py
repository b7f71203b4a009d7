"""What most requests ask for, answered before the framework is asked: frames, passages, advice and maps.

A framework that reads parameters off signatures costs several times what the answer does. So the front binds the same
functions that the framework would call, and calls them itself. It only takes requests that are as they should be;
whatever is odd about one, it is handed on with its body, and the framework says what. The description of the
interface, every validation and every complaint are therefore the framework's own.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial

from fastapi import Response
from pydantic import ValidationError
from starlette.types import ASGIApp, Receive, Scope, Send

from roadgrip.records import Rejected
from rsu_app.adapters.http.frames import FRAMES_MEDIA_TYPE, FRAMES_PATH, frames_answered, sender_of
from rsu_app.adapters.http.guards import read_again, read_body
from rsu_app.adapters.http.models import PassageModel
from rsu_app.adapters.http.problems import ProblemError, problem_response
from rsu_app.adapters.http.sections import (
    ADVISORY_PATH,
    MAP_PATH,
    PASSAGES_PATH,
    passage_answered,
    section_advisory,
    section_map,
)
from rsu_app.adapters.http.site import Site

ADVISORY_LIFE_S = 0.25
"""An advisory changes with every passage and every second. Rendered so often, any number of readers costs the same."""

JSON_MEDIA_TYPE = "application/json"


class NotAsUsual(Exception):  # noqa: N818 - nothing is wrong; somebody else looks at it
    """The framework shall decide about this request."""


@dataclass(frozen=True, slots=True)
class _Route:
    """A path that the front answers, with the template that its requests are counted by."""

    method: str
    template: str
    answer: Callable[[Scope, bytes], Awaitable[Response]]


@dataclass(frozen=True, slots=True)
class _Rendered:
    """An advisory as it was said a moment ago, by the model and about the map that were there then."""

    response: Response
    until_s: float
    model: object
    map_version: str


class Front:
    """Answers the usual requests, and hands all others on.

    Args:
        app: The framework's.
        site: The unit as HTTP sees it.
        on_bug: Returns what is said, for a path, when answering it failed in a way that nobody thought of.
    """

    def __init__(self, app: ASGIApp, *, site: Site, on_bug: Callable[[str, Exception], Response]) -> None:
        self._app = app
        self._on_bug = on_bug
        self._site = site
        self._advice: dict[str, _Rendered] = {}
        self._routes = {FRAMES_PATH: _Route("POST", FRAMES_PATH, self._frames)}
        for section_id in site.unit.section_ids:
            for method, template, answer in (
                ("GET", ADVISORY_PATH, self._advisory),
                ("GET", MAP_PATH, self._map),
                ("POST", PASSAGES_PATH, self._passage),
            ):
                path = template.format(section_id=section_id)
                self._routes[path] = _Route(method, template, partial(answer, section_id))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or hand the request on."""
        route = self._routes.get(scope["path"]) if scope["type"] == "http" else None
        if route is None or scope["method"] != route.method:
            await self._app(scope, receive, send)
            return
        body = b""
        try:
            if route.method == "POST" or _has_body(scope):
                read = await read_body(scope, receive, limit_bytes=self._site.body_limit_bytes)
                if read is None:  # the client left
                    return
                body, receive = read, read_again(read, receive)
            response = await route.answer(scope, body)
        except NotAsUsual:
            await self._app(scope, receive, send)
            return
        except ProblemError as error:
            response = problem_response(error)
        except Exception as error:
            await self._say(route, self._on_bug(scope["path"], error), send)
            raise  # for the server's log
        await self._say(route, response, send)

    async def _say(self, route: _Route, response: Response, send: Send) -> None:
        self._site.metrics.http_requests.count(route.template, str(response.status_code))
        await send({"type": "http.response.start", "status": response.status_code, "headers": response.raw_headers})
        await send({"type": "http.response.body", "body": response.body})

    async def _frames(self, scope: Scope, body: bytes) -> Response:
        _expect_media_type(scope, FRAMES_MEDIA_TYPE)
        return await frames_answered(self._site, body, sender=sender_of(scope))

    async def _passage(self, section_id: str, scope: Scope, body: bytes) -> Response:
        _expect_media_type(scope, JSON_MEDIA_TYPE)
        try:
            passage = PassageModel.model_validate_json(body)
        except ValidationError:
            raise NotAsUsual from None
        receipt = await passage_answered(self._site, section_id, passage, sender=sender_of(scope))
        return Response(receipt.model_dump_json(), media_type=JSON_MEDIA_TYPE)

    async def _map(self, section_id: str, scope: Scope, body: bytes) -> Response:
        _expect_no_body(body)
        return await section_map(
            self._site,
            section_id,
            accept=_header(scope, b"accept") or JSON_MEDIA_TYPE,
            if_none_match=_header(scope, b"if-none-match") or "",
        )

    async def _advisory(self, section_id: str, _scope: Scope, body: bytes) -> Response:
        _expect_no_body(body)
        now_s, offer = self._site.now_s(), self._site.unit.map_offer(section_id)
        if isinstance(offer, Rejected):
            raise NotAsUsual
        model, map_version = self._site.unit.model, offer.section.version
        known = self._advice.get(section_id)
        if known is None or now_s >= known.until_s or known.model is not model or known.map_version != map_version:
            said = (await section_advisory(self._site, section_id)).model_dump_json()
            response = Response(said, media_type=JSON_MEDIA_TYPE)
            known = self._advice[section_id] = _Rendered(response, now_s + ADVISORY_LIFE_S, model, map_version)
        return known.response


def _header(scope: Scope, name: bytes) -> str | None:
    """Return the first header of a name, as the framework does."""
    return next((v.decode("latin-1") for k, v in scope["headers"] if k == name), None)


def _has_body(scope: Scope) -> bool:
    return any(k in {b"content-length", b"transfer-encoding"} for k, _ in scope["headers"])


def _expect_media_type(scope: Scope, media_type: str) -> None:
    if (_header(scope, b"content-type") or "").partition(";")[0].strip() != media_type:
        raise NotAsUsual


def _expect_no_body(body: bytes) -> None:
    if body:
        raise NotAsUsual
