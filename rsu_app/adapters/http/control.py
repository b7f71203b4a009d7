"""What an operator on the machine may ask of the running unit: an application of its own, on a Unix socket.

The socket's file belongs to the unit's account and to nobody else; whoever can open it could as well replace the unit.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any

from fastapi import Depends, FastAPI, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from roadgrip.errors import ConfigurationError
from roadgrip.release import Release
from rsu_app.rollout_ports import ReleaseSource, UpdateRefusal
from rsu_app.unix_socket import socket_name
from rsu_app.usecases.rollout import Rollout

_SOCKET_MODE = 0o600


class _Order(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    actor: str = Field(min_length=1, max_length=100, description="Who asks, for the ledger.")


class UpdateOrder(_Order):
    """Look for a release."""

    source: str = Field(default="", max_length=4_096, description="A folder or URL; empty: the configured one.")


class StepOrder(_Order):
    """Take a step that the rollout would not take by itself."""

    reason: str = Field(min_length=1, max_length=2_000, description="Why, for the ledger.")


class Outcome(BaseModel):
    """What came of an order.

    Attributes:
        done: Whether anything was done.
        reason: Code of the refusal; empty without one.
        detail: For a person.
    """

    done: bool
    reason: str = ""
    detail: str


@dataclass(frozen=True, slots=True)
class ControlDesk:
    """What orders are given to.

    Attributes:
        rollout: Takes releases up.
        source_of: Returns what a handed folder or URL is as a source of releases; None for the configured one.
        status: Returns everything an operator looks at, ready to be sent.
    """

    rollout: Rollout
    source_of: Callable[[str], ReleaseSource | None]
    status: Callable[[], Awaitable[dict[str, Any]]]


async def _desk_of(request: Request) -> ControlDesk:
    desk: ControlDesk = request.app.state.desk
    return desk


DeskOf = Annotated[ControlDesk, Depends(_desk_of)]


def create_control_app(desk: ControlDesk) -> FastAPI:
    """Return the application that takes orders."""
    app = FastAPI(title="roadgrip road side unit: control", docs_url=None, redoc_url=None, openapi_url=None)
    app.state.desk = desk
    app.add_api_route("/status", _status, methods=["GET"])
    app.add_api_route("/update", _update, methods=["POST"])
    app.add_api_route("/switch", _switch, methods=["POST"])
    app.add_api_route("/rollback", _rollback, methods=["POST"])
    return app


async def obey(desk: ControlDesk, path: str, order: dict[str, Any]) -> dict[str, Any]:
    """Return what comes of an order that came by no socket; the same as over one.

    Raises:
        KeyError: There is no such order.
    """
    response = Response()
    match path:
        case "/update":
            outcome = await _update(UpdateOrder(**order), desk, response)
        case "/switch":
            outcome = await _switch(StepOrder(**order), desk, response)
        case "/rollback":
            outcome = await _rollback(StepOrder(**order), desk, response)
        case _:
            raise KeyError(path)
    return outcome.model_dump()


async def _status(desk: DeskOf) -> dict[str, Any]:
    return await desk.status()


async def _update(order: UpdateOrder, desk: DeskOf, response: Response) -> Outcome:
    source = desk.source_of(order.source) if order.source else None
    found = await (
        desk.rollout.look(actor=order.actor) if source is None else desk.rollout.update_from(source, actor=order.actor)
    )
    if isinstance(found, Release):
        stage = desk.rollout.status.state.stage.value
        return Outcome(done=True, detail=f"release {found.sequence_number}, bundle {found.bundle_id}: {stage}")
    if found is None:
        return Outcome(done=False, detail="there is no newer release")
    return _refused(found, response)


async def _switch(order: StepOrder, desk: DeskOf, response: Response) -> Outcome:
    refusal = await desk.rollout.switch_now(order.reason, actor=order.actor)
    return _refused(refusal, response) if refusal else _done(desk)


async def _rollback(order: StepOrder, desk: DeskOf, response: Response) -> Outcome:
    refusal = await desk.rollout.roll_back(order.reason, actor=order.actor)
    return _refused(refusal, response) if refusal else _done(desk)


def _done(desk: ControlDesk) -> Outcome:
    return Outcome(done=True, detail=f"bundle {desk.rollout.live_id} is live")


def _refused(refusal: UpdateRefusal, response: Response) -> Outcome:
    response.status_code = HTTPStatus.CONFLICT
    return Outcome(done=False, reason=refusal.reason.value, detail=refusal.detail)


def control_socket(path: Path) -> socket.socket:
    """Return a bound Unix socket that only its owner may open; one that a killed unit left behind makes room.

    Raises:
        ConfigurationError: Another unit answers there.
        OSError: It cannot be bound.
    """
    if _answers(path):
        raise ConfigurationError(f"another unit answers at {path}; two units cannot share a shelf of bundles")
    link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        with socket_name(path) as name:
            link.bind(name)
        path.chmod(_SOCKET_MODE)
    except OSError:
        link.close()
        raise
    link.setblocking(False)  # noqa: FBT003 - the standard library's signature
    return link


def _answers(path: Path) -> bool:
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)) as probe:
        try:
            with socket_name(path) as name:
                probe.connect(name)
        except OSError:
            return False
    return True
