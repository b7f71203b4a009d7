"""What single senders may do at the gateway, and what they may make it do to others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.records import Arrival, Cookie, Passage
from rsu_app.cookies import Cookies
from rsu_app.gateway import Sender
from rsu_app.sender_guards import SenderGuards
from tests.rsu_app.fakes import make_passage, make_section
from tests.rsu_app.sites import frame_of_passage, frames_of, make_unit, read_replies

SECTION = make_section()
CAR = Sender("198.51.100.7", 5000, proven=False)
ARRIVAL = Arrival(b"p" * 16, SECTION.section_id)


def frame_of(message: Arrival | Passage) -> bytes:
    if isinstance(message, Passage):
        return frame_of_passage(message)
    (frame,) = frames_of(message, passage_id=message.passage_id, section_id=message.section_id)
    return frame


def guarded(**limits):
    return make_unit(section=SECTION, guards=SenderGuards(cookies=Cookies(b"s" * 32), **limits))


def answered(under_test, message, sender=CAR):
    taken = under_test.gateway.take(frame_of(message), via="udp", sender=sender)
    return read_replies(taken.replies)


def test_an_address_that_nobody_has_seen_is_asked_for_a_cookie_first():
    (cookie,) = answered(guarded(), ARRIVAL)
    assert isinstance(cookie, Cookie)


def test_whoever_shows_the_cookie_gets_map_and_advisory():
    under_test = guarded()
    (cookie,) = answered(under_test, ARRIVAL)
    answer = answered(under_test, replace(ARRIVAL, cookie=cookie.cookie))
    assert [type(message).__name__ for message in answer] == ["MapOffer", "AdvisoryNotice"]


def test_a_cookie_of_another_address_is_worth_nothing():
    under_test = guarded()
    (cookie,) = answered(under_test, ARRIVAL)
    elsewhere = CAR._replace(host="203.0.113.9")
    (again,) = answered(under_test, replace(ARRIVAL, cookie=cookie.cookie), sender=elsewhere)
    assert isinstance(again, Cookie)


def test_over_tcp_nobody_is_asked_for_a_cookie():
    answer = answered(guarded(), ARRIVAL, sender=CAR._replace(proven=True))
    assert [type(message).__name__ for message in answer] == ["MapOffer", "AdvisoryNotice"]


@given(st.integers(0, 2**32 - 1), st.integers(0, 120), st.booleans())
def test_nothing_makes_the_unit_send_a_stranger_more_than_it_was_sent(seed, cut_bytes, spoiled):
    under_test = guarded()
    rng = np.random.default_rng(seed)
    datagram = bytearray(frame_of([ARRIVAL, make_passage(SECTION), Arrival(b"q" * 16, "elsewhere")][seed % 3]))
    if spoiled:
        datagram[rng.integers(len(datagram))] ^= 1 << rng.integers(8)
    datagram = datagram[: max(0, len(datagram) - cut_bytes)]
    taken = under_test.gateway.take(bytes(datagram), via="udp", sender=CAR)
    assert sum(len(frame) for reply in taken.replies for frame in reply.frames) <= len(datagram)


def test_an_address_may_send_so_many_frames_a_second():
    under_test = guarded(frames_per_s=5.0)
    for number in range(8):
        under_test.gateway.take(frame_of(make_passage(SECTION, seed=number)), via="udp", sender=CAR)
    assert under_test.count("roadgrip_frames_dropped_total", via="udp", reason="rate_limited") == 3


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "192.0.2.1"])
def test_the_machine_itself_and_a_radio_are_not_counted(host):
    under_test = guarded(frames_per_s=1.0, free_hosts=["192.0.2.1"])
    for number in range(8):
        under_test.gateway.take(frame_of(make_passage(SECTION, seed=number)), via="udp", sender=CAR._replace(host=host))
    assert under_test.count("roadgrip_frames_dropped_total", via="udp", reason="rate_limited") == 0


def test_a_cookie_is_no_longer_than_the_shortest_question():
    shortest = Arrival(b"p" * 16, "a")
    (cookie_frame,) = frames_of(Cookie(bytes(8)), passage_id=shortest.passage_id, section_id=shortest.section_id)
    assert len(cookie_frame) <= len(frame_of(shortest))
