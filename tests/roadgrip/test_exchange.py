"""The rules of one exchange: what belongs to it and what it may cost."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.certified import VERIFIER
from roadgrip.errors import WireError
from roadgrip.exchange import FROM_UNIT, FROM_VEHICLE, ExchangeLedger, FrameBudget, Reception, message_of
from roadgrip.frames import (
    Complete,
    Frame,
    Reassembler,
    exchange_id_of,
    parse_frame,
    section_key_of,
    split_into_frames,
    unread_passage_id,
)
from roadgrip.reasons import Reason
from roadgrip.records import RSU_FRAME_BUDGET, VEHICLE_FRAME_BUDGET, Message, Passage, Receipt, Rejected
from roadgrip.wire import Kind, encode_message, kind_of
from tests.roadgrip.wire_samples import PASSAGE, PASSAGE_ID, SAMPLES, SECTION

EXCHANGE_ID = exchange_id_of(PASSAGE_ID)
SECTION_KEY = section_key_of(SECTION.section_id)


def completed(message: Message, *, exchange_id: bytes = EXCHANGE_ID, section_key: bytes = SECTION_KEY) -> Complete:
    return Complete(kind_of(message), section_key, exchange_id, encode_message(message))


def frame_of(content: int, *, exchange_id: bytes = EXCHANGE_ID) -> Frame:
    payload = content.to_bytes(4, "big")
    (datagram,) = split_into_frames(Kind.SUMMARY, payload, exchange_id=exchange_id, section_key=SECTION_KEY)
    return parse_frame(datagram)


def ledger(*, limit_count: int = 100, timeout_s: float = 7200.0) -> ExchangeLedger:
    return ExchangeLedger(limit_count=limit_count, timeout_s=timeout_s)


# What belongs to an exchange.


@pytest.mark.parametrize("name", [name for name in SAMPLES if name != "map-in-pieces"])
def test_a_message_that_agrees_with_its_frames_is_read(name):
    assert message_of(completed(SAMPLES[name]), expected=FROM_VEHICLE | FROM_UNIT).message == SAMPLES[name]


@pytest.mark.parametrize("name", ["arrival", "summary", "receipt-accepted"])
def test_a_message_under_the_exchange_of_another_is_malformed(name):
    with pytest.raises(WireError) as caught:
        message_of(completed(SAMPLES[name], exchange_id=bytes(8)), expected=FROM_VEHICLE | FROM_UNIT)
    assert caught.value.reason is Reason.MALFORMED


@pytest.mark.parametrize("name", ["arrival", "summary", "map", "advisory", "beacon"])
def test_a_message_under_the_section_key_of_another_is_malformed(name):
    with pytest.raises(WireError) as caught:
        message_of(completed(SAMPLES[name], section_key=bytes(4)), expected=FROM_VEHICLE | FROM_UNIT)
    assert caught.value.reason is Reason.MALFORMED


@pytest.mark.parametrize("kind", Kind)
def test_every_kind_flies_one_way(kind):
    assert (kind in FROM_VEHICLE) != (kind in FROM_UNIT)


def test_a_message_that_flies_the_other_way_is_not_even_read():
    rubbish = Complete(Kind.MAP, SECTION_KEY, EXCHANGE_ID, b"rubbish")
    with pytest.raises(WireError, match="other way"):
        message_of(rubbish, expected=FROM_VEHICLE)


def test_the_verifier_is_asked():
    with pytest.raises(WireError) as caught:
        message_of(completed(PASSAGE), expected=FROM_VEHICLE, verifier=VERIFIER, required=True)
    assert caught.value.reason is Reason.UNSIGNED


def test_the_receipt_of_an_unread_message_belongs_to_its_exchange():
    receipt = Receipt(unread_passage_id(EXCHANGE_ID), Rejected(Reason.MALFORMED))
    assert message_of(completed(receipt), expected=FROM_UNIT).message == receipt


def test_a_summary_sent_again_with_a_greater_age_arrives_with_the_age_of_the_frame_that_arrived():
    assembly = Reassembler(limit_count=10, limit_bytes=100_000, timeout_s=10.0)
    ages_s = []
    for age_s in (0.5, 1.7, 600.0):
        passage = dataclasses.replace(PASSAGE, age_s=age_s)
        (datagram,) = split_into_frames(
            Kind.SUMMARY, encode_message(passage), exchange_id=EXCHANGE_ID, section_key=SECTION_KEY
        )
        complete = assembly.offer(parse_frame(datagram), source="vehicle", now_s=age_s)
        assert complete is not None
        message = message_of(complete, expected=FROM_VEHICLE).message
        assert isinstance(message, Passage)
        ages_s.append(message.age_s)
    assert ages_s == [0.5, 1.7, 600.0]


# What it may cost.


def test_both_budgets_make_twenty_frames():
    assert VEHICLE_FRAME_BUDGET + RSU_FRAME_BUDGET == 20


@given(st.lists(st.integers(1, 6)))
def test_a_budget_is_never_overdrawn_and_a_message_is_sent_whole_or_not_at_all(wanted):
    budget = FrameBudget(VEHICLE_FRAME_BUDGET)
    sent = 0
    for frames_count in wanted:
        before = budget.left_count
        if budget.take(frames_count):
            sent += frames_count
            assert budget.left_count == before - frames_count
        else:
            assert budget.left_count == before < frames_count
    assert sent <= VEHICLE_FRAME_BUDGET


def test_a_vehicle_may_send_twelve_different_frames_and_the_thirteenth_is_refused():
    books = ledger()
    receptions = [books.receive(frame_of(i), now_s=0.0) for i in range(14)]
    assert receptions == [Reception.NEW] * 12 + [Reception.EXHAUSTED] * 2
    assert (books.received_count(EXCHANGE_ID), books.counters.refused_count) == (12, 2)


def test_duplicates_use_up_nobodys_budget():
    books = ledger()
    assert books.receive(frame_of(1), now_s=0.0) is Reception.NEW
    assert {books.receive(frame_of(1), now_s=0.0) for _ in range(50)} == {Reception.DUPLICATE}
    assert [books.receive(frame_of(i), now_s=0.0) for i in range(2, 13)] == [Reception.NEW] * 11
    assert books.receive(frame_of(1), now_s=0.0) is Reception.DUPLICATE
    assert books.counters.duplicates_count == 51


def test_a_unit_may_send_eight_frames_in_an_exchange():
    books = ledger()
    assert books.reserve(EXCHANGE_ID, frames_count=6, now_s=0.0)
    assert not books.reserve(EXCHANGE_ID, frames_count=3, now_s=0.0)
    assert books.reserve(EXCHANGE_ID, frames_count=2, now_s=0.0)
    assert not books.reserve(EXCHANGE_ID, frames_count=1, now_s=0.0)
    assert (books.sent_count(EXCHANGE_ID), books.counters.withheld_count) == (8, 4)


def test_exchanges_have_budgets_of_their_own():
    books = ledger()
    for i in range(12):
        books.receive(frame_of(i), now_s=0.0)
    assert books.receive(frame_of(1, exchange_id=bytes(8)), now_s=0.0) is Reception.NEW
    assert books.reserve(bytes(8), frames_count=8, now_s=0.0)
    assert books.sent_count(EXCHANGE_ID) == 0


def test_an_exchange_is_forgotten_when_it_has_been_silent_for_long():
    books = ledger(timeout_s=100.0)
    books.receive(frame_of(1), now_s=0.0)
    books.receive(frame_of(2), now_s=90.0)
    books.receive(frame_of(1, exchange_id=bytes(8)), now_s=180.0)
    assert books.received_count(EXCHANGE_ID) == 2
    books.receive(frame_of(2, exchange_id=bytes(8)), now_s=191.0)
    assert books.received_count(EXCHANGE_ID) == 0
    assert books.counters.evicted_count == 0


def test_the_longest_silent_exchange_is_forgotten_when_there_are_too_many():
    books = ledger(limit_count=3)
    ids = [bytes([i]) * 8 for i in range(4)]
    for exchange_id in (*ids[:3], ids[0], ids[3]):
        books.receive(frame_of(1, exchange_id=exchange_id), now_s=0.0)
    assert [books.received_count(exchange_id) for exchange_id in ids] == [1, 0, 1, 1]
    assert (books.open_count, books.counters.evicted_count) == (3, 1)


@given(
    st.lists(
        st.tuples(st.integers(0, 5), st.booleans(), st.integers(0, 20), st.floats(0.0, 50.0)),
        max_size=200,
    )
)
def test_whatever_happens_no_account_is_overdrawn_and_memory_is_bounded(events):
    books = ExchangeLedger(limit_count=4, timeout_s=30.0)
    now_s = 0.0
    for exchange, ours, content, step_s in events:
        now_s += step_s
        exchange_id = bytes([exchange]) * 8
        if ours:
            books.reserve(exchange_id, frames_count=1 + content % 6, now_s=now_s)
        else:
            books.receive(frame_of(content, exchange_id=exchange_id), now_s=now_s)
        assert books.open_count <= 4
        assert books.sent_count(exchange_id) <= RSU_FRAME_BUDGET
        assert books.received_count(exchange_id) <= VEHICLE_FRAME_BUDGET
