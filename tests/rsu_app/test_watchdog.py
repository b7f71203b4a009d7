from __future__ import annotations

import socket
from collections.abc import Iterator
from math import inf

import pytest

from rsu_app.ports import WriterPulse
from rsu_app.watchdog import ServiceManager, manager_of, tell, tell_how_it_is

BUSY = WriterPulse(committed_ago_s=3.0, busy_s=2.0, queued_count=5)
STUCK = WriterPulse(committed_ago_s=90.0, busy_s=31.0, queued_count=512)
FULL_DISK = WriterPulse(committed_ago_s=None, busy_s=0.0, queued_count=0)
DEAD = WriterPulse(committed_ago_s=90.0, busy_s=inf, queued_count=1)


@pytest.fixture(params=["a file", "an abstract name"])
def ear(request, tmp_path) -> Iterator[tuple[str, socket.socket]]:
    """The address of a manager as its variable holds it, and the manager's end."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        if request.param == "a file":
            link.bind(str(tmp_path / "notify"))
            address = str(tmp_path / "notify")
        else:
            link.bind("")  # Linux chooses a free abstract name
            address = "@" + link.getsockname()[1:].decode()
        link.setblocking(False)
        yield address, link


def heard(link: socket.socket) -> list[str]:
    said = []
    while True:
        try:
            said.append(link.recv(4096).decode())
        except BlockingIOError:
            return said


def test_the_manager_hears_every_line_in_one_datagram(ear):
    address, link = ear
    assert tell(ServiceManager(address), "READY=1", "STATUS=serving")
    assert heard(link) == ["READY=1\nSTATUS=serving"]


@pytest.mark.parametrize("address", ["", "/nowhere/notify", "@nobody listens here", "vsock:2:1234"])
def test_where_nobody_listens_nothing_fails(address):
    assert not tell(ServiceManager(address), "READY=1")


def test_a_manager_whose_socket_is_full_is_not_waited_for(ear):
    address, _ = ear
    manager = ServiceManager(address)
    assert any(not tell(manager, "WATCHDOG=1") for _ in range(100_000))


@pytest.mark.parametrize(
    ("environment", "address", "watchdog_s"),
    [
        ({}, "", None),
        ({"NOTIFY_SOCKET": "/run/n", "WATCHDOG_USEC": "30000000"}, "/run/n", 30.0),
        ({"NOTIFY_SOCKET": "@n", "WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "7"}, "@n", 30.0),
        ({"NOTIFY_SOCKET": "@n", "WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "8"}, "@n", None),
        ({"WATCHDOG_USEC": "soon"}, "", None),
        ({"WATCHDOG_USEC": "0"}, "", None),
    ],
)
def test_the_environment_says_who_started_the_unit(environment, address, watchdog_s):
    assert manager_of(environment, process_number=7) == ServiceManager(address, watchdog_s)


@pytest.mark.parametrize("pulse", [BUSY, FULL_DISK])
def test_a_unit_that_writes_or_is_refused_by_a_full_disk_lives(ear, pulse):
    address, link = ear
    assert tell_how_it_is(ServiceManager(address, watchdog_s=30.0), pulse, status="serving")
    assert heard(link) == ["WATCHDOG=1\nSTATUS=serving"]


@pytest.mark.parametrize("pulse", [STUCK, DEAD])
def test_a_unit_whose_writer_is_stuck_gives_no_sign_of_life(ear, pulse):
    address, link = ear
    assert not tell_how_it_is(ServiceManager(address, watchdog_s=30.0), pulse, status="serving")
    (said,) = heard(link)
    assert said.startswith("STATUS=the same write has been under way")


def test_a_manager_that_does_not_watch_is_only_told_the_status(ear):
    address, link = ear
    assert tell_how_it_is(ServiceManager(address), STUCK, status="serving")
    assert heard(link) == ["STATUS=serving"]


@pytest.mark.parametrize(("watchdog_s", "period_s"), [(30.0, 15.0), (None, 10.0)])
def test_signs_of_life_come_twice_in_the_time_of_the_manager_s_patience(watchdog_s, period_s):
    assert ServiceManager("@n", watchdog_s).period_s == period_s
