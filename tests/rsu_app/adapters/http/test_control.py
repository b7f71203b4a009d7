from __future__ import annotations

import asyncio
import socket
from typing import Any

import httpx
import pytest

from roadgrip.errors import ConfigurationError
from rsu_app.adapters.http.control import ControlDesk, control_socket, create_control_app, obey
from rsu_app.rollout_ports import UpdateReason, UpdateRefusal
from tests.rsu_app.fakes import FakeSource
from tests.rsu_app.usecases.depot import GOOD, GOOD_ID, Depot


def desk_of(depot: Depot, handed: FakeSource | None = None) -> ControlDesk:
    async def status() -> dict[str, Any]:
        return {"stage": depot.stage.value}

    return ControlDesk(rollout=depot.rollout, source_of=lambda _: handed, status=status)


def asked(desk: ControlDesk, method: str, path: str, order: dict[str, Any] | None = None) -> httpx.Response:
    async def ask() -> httpx.Response:
        transport = httpx.ASGITransport(app=create_control_app(desk))
        async with httpx.AsyncClient(transport=transport, base_url="http://unit") as client:
            return await client.request(method, path, json=order)

    return asyncio.run(ask())


def test_an_operator_orders_a_look_a_switch_and_a_step_back():
    depot = Depot()
    factory_id = depot.live_id
    depot.release(1, GOOD)
    answer = asked(desk_of(depot), "POST", "/update", {"actor": "ann"})
    assert (answer.status_code, answer.json()["done"]) == (200, True)
    assert "shadow" in answer.json()["detail"]
    answer = asked(desk_of(depot), "POST", "/switch", {"actor": "ann", "reason": "now"})
    assert GOOD_ID in answer.json()["detail"]
    answer = asked(desk_of(depot), "POST", "/rollback", {"actor": "ann", "reason": "no"})
    assert factory_id in answer.json()["detail"]


def test_without_news_nothing_is_done():
    answer = asked(desk_of(Depot()), "POST", "/update", {"actor": "ann"}).json()
    assert (answer["done"], answer["reason"]) == (False, "")


def test_a_handed_folder_is_looked_at_in_place_of_the_configured_source():
    depot, handed = Depot(), FakeSource()
    handed.refusal = UpdateRefusal(UpdateReason.TAMPERED, "a file differs")
    depot.release(1, GOOD)
    answer = asked(desk_of(depot, handed), "POST", "/update", {"actor": "ann", "source": "/media/stick"})
    assert (answer.status_code, answer.json()["reason"]) == (409, "tampered")


@pytest.mark.parametrize("path", ["/switch", "/rollback"])
def test_a_step_that_cannot_be_taken_is_refused_with_its_reason(path):
    answer = asked(desk_of(Depot()), "POST", path, {"actor": "ann", "reason": "why not"})
    assert (answer.status_code, answer.json()["reason"]) == (409, "no_release")


@pytest.mark.parametrize(
    "order",
    [{}, {"actor": ""}, {"actor": "ann"}, {"actor": "ann", "reason": ""}, {"actor": "a", "reason": "b", "c": 1}],
)
def test_an_order_without_a_name_or_a_reason_is_no_order(order):
    assert asked(desk_of(Depot()), "POST", "/rollback", order).status_code == 422


def test_a_unit_that_does_not_run_obeys_the_same_orders():
    async def story():
        depot = Depot()
        depot.release(1, GOOD)
        assert (await obey(desk_of(depot), "/update", {"actor": "ann"}))["done"]
        assert (await obey(desk_of(depot), "/switch", {"actor": "ann", "reason": "now"}))["done"]
        assert (await obey(desk_of(depot), "/rollback", {"actor": "ann", "reason": "no"}))["done"]
        with pytest.raises(KeyError):
            await obey(desk_of(depot), "/nonsense", {})

    asyncio.run(story())


def test_the_status_is_what_the_desk_says():
    assert asked(desk_of(Depot()), "GET", "/status").json() == {"stage": "settled"}


def test_a_socket_that_a_killed_unit_left_behind_makes_room(tmp_path):
    path = tmp_path / "control.sock"
    control_socket(path).close()
    assert path.exists()
    link = control_socket(path)
    assert path.stat().st_mode & 0o777 == 0o600
    link.close()


def test_a_socket_where_a_unit_answers_is_left_alone(tmp_path):
    path = tmp_path / "control.sock"
    link = control_socket(path)
    link.listen()
    with pytest.raises(ConfigurationError, match="another unit"):
        control_socket(path)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.connect(str(path))
    link.close()


def test_a_folder_that_cannot_be_made_is_said_so(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        control_socket(tmp_path / "file" / "control.sock")


def test_a_folder_may_lie_deeper_than_the_kernel_has_room_for_its_name(tmp_path):
    path = tmp_path / ("x" * 60) / ("y" * 60) / "control.sock"
    link = control_socket(path)
    link.listen()
    with pytest.raises(ConfigurationError, match="another unit"):
        control_socket(path)
    link.close()
