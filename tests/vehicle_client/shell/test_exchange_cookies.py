"""A unit that wants to know whether its answers arrive asks with a cookie."""

from __future__ import annotations

from math import inf

import pytest

from roadgrip.records import VEHICLE_FRAME_BUDGET, AdvisoryNotice, Arrival, Cookie, Message
from tests.vehicle_client.shell.air import ADVICE, BEND, PASSAGE_ID, SUMMARY, Ether
from tests.vehicle_client.shell.test_exchange import an_exchange, hear
from vehicle_client.shell.exchange import Stage
from vehicle_client.shell.patience import Patience


def announced(ether: Ether, frames: tuple[bytes, ...]) -> list[Message]:
    return [ether.cargo[frame][2] for frame in frames]


def test_an_announcement_is_repeated_at_once_with_the_cookie():
    ether = Ether()
    exchange = an_exchange(ether)
    exchange.begin(now_s=0.0)
    hear(exchange, ether, Cookie(b"biscuit!"), now_s=0.1)
    assert exchange.wake_at_s == 0.1
    assert announced(ether, exchange.tick(now_s=0.1)) == [Arrival(PASSAGE_ID, "bend", cookie=b"biscuit!")]
    record = exchange.record()
    assert (record.arrival_tries_count, record.frames_sent_count, record.messages_ignored_count) == (1, 2, 0)
    assert exchange.wake_at_s == pytest.approx(0.6)


def test_later_announcements_keep_the_cookie():
    ether = Ether()
    exchange = an_exchange(ether)
    exchange.begin(now_s=0.0)
    hear(exchange, ether, Cookie(b"biscuit!"), now_s=0.1)
    exchange.tick(now_s=0.1)
    assert announced(ether, exchange.tick(now_s=10.0)) == [Arrival(PASSAGE_ID, "bend", cookie=b"biscuit!")]


def test_only_two_cookies_are_followed_and_then_the_usual_patience_holds():
    ether = Ether()
    exchange = an_exchange(ether)
    sent = len(exchange.begin(now_s=0.0))
    for number in range(50):
        hear(exchange, ether, Cookie(number.to_bytes(8, "big")), now_s=0.1)
        sent += len(exchange.tick(now_s=0.1))
    assert sent == 3
    assert exchange.record().messages_ignored_count == 48
    now_s = 0.1
    while exchange.stage is Stage.ARRIVING:
        now_s = exchange.wake_at_s
        sent += len(exchange.tick(now_s=now_s))
    assert sent == Patience().arrival_tries_count + 2
    assert exchange.record().arrival_tries_count == Patience().arrival_tries_count


def test_a_cookie_that_comes_when_everything_is_there_is_ignored():
    ether = Ether()
    exchange = an_exchange(ether, known=BEND)
    exchange.begin(now_s=0.0)
    hear(exchange, ether, AdvisoryNotice("bend", BEND.version, ADVICE, issued_unix_s=0), now_s=0.1)
    hear(exchange, ether, Cookie(b"biscuit!"), now_s=0.2)
    assert exchange.stage is Stage.DRIVING
    assert exchange.wake_at_s == inf


def test_cookies_leave_frames_for_the_report():
    ether = Ether()
    exchange = an_exchange(ether, known=BEND)
    sent = len(exchange.begin(now_s=0.0))
    for number in range(2):
        hear(exchange, ether, Cookie(number.to_bytes(8, "big")), now_s=0.0)
        sent += len(exchange.tick(now_s=0.0))
    while exchange.stage is Stage.ARRIVING:
        sent += len(exchange.tick(now_s=exchange.wake_at_s))
    sent += len(exchange.report(SUMMARY, map_version=BEND.version, left_at_s=60.0, now_s=60.0))
    while exchange.stage is Stage.REPORTING:
        sent += len(exchange.tick(now_s=exchange.wake_at_s))
    assert sent == exchange.record().frames_sent_count <= VEHICLE_FRAME_BUDGET
    assert exchange.record().report_tries_count == Patience().report_tries_count
