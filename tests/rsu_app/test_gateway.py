import asyncio
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from bench.certified import UNIT, VERIFIER, signer_of
from roadgrip.certificates import Role
from roadgrip.errors import WireError
from roadgrip.frames import exchange_id_of, parse_frame, split_into_frames, unread_passage_id
from roadgrip.reasons import Reason
from roadgrip.records import (
    RSU_FRAME_BUDGET,
    VEHICLE_FRAME_BUDGET,
    Accepted,
    AdvisoryNotice,
    Arrival,
    Beacon,
    MapOffer,
    NotCounted,
    Receipt,
    Rejected,
)
from roadgrip.signing import Verifier
from roadgrip.wire import rounded_to_wire
from rsu_app.gateway import RECEIPTS_RESERVED_COUNT
from tests.rsu_app.fakes import make_passage, make_section
from tests.rsu_app.sites import UnitUnderTest, frame_of_passage, frames_of, make_unit, radio, read_frames, read_replies

SECTION = make_section()
ID = bytes(range(16))


def arrival_frame(passage_id: bytes = ID, *, known: str = "", section_id: str = SECTION.section_id) -> bytes:
    arrival = Arrival(passage_id, section_id, known_map_version=known)
    (frame,) = frames_of(arrival, passage_id=passage_id, section_id=section_id)
    return frame


def answers(under_test: UnitUnderTest, frame: bytes, *, verifier: Verifier | None = None):
    return asyncio.run(radio(under_test, frame, verifier=verifier))


def test_an_arrival_is_answered_with_map_and_advisory():
    under_test = make_unit(section=SECTION)
    offer, notice = answers(under_test, arrival_frame())
    assert isinstance(offer, MapOffer)
    assert offer.section == SECTION
    assert isinstance(notice, AdvisoryNotice)
    expected = under_test.unit.advisory_notice(SECTION.section_id)
    assert isinstance(expected, AdvisoryNotice)
    assert notice == rounded_to_wire(expected)


def test_a_vehicle_that_has_the_map_gets_the_advisory_alone():
    (notice,) = answers(make_unit(section=SECTION), arrival_frame(known=SECTION.version))
    assert isinstance(notice, AdvisoryNotice)


def test_a_vehicle_with_an_old_map_gets_the_new_one():
    offer, _ = answers(make_unit(section=SECTION), arrival_frame(known="0" * 16))
    assert isinstance(offer, MapOffer)


def test_an_arrival_at_an_unknown_section_is_refused():
    (receipt,) = answers(make_unit(section=SECTION), arrival_frame(section_id="elsewhere"))
    assert isinstance(receipt, Receipt)
    assert receipt.passage_id == unread_passage_id(exchange_id_of(ID))
    assert isinstance(receipt.outcome, Rejected)
    assert receipt.outcome.reason is Reason.UNKNOWN_SECTION


def test_a_summary_is_answered_with_a_receipt_after_it_is_stored():
    under_test = make_unit(section=SECTION)
    passage = make_passage(SECTION)
    assert answers(under_test, frame_of_passage(passage)) == [Receipt(passage.passage_id, Accepted())]
    assert [e.passage.passage_id for e in under_test.store.entries] == [passage.passage_id]


def test_no_receipt_leaves_before_the_commit():
    async def scenario():
        under_test = make_unit(section=SECTION)
        under_test.store.gate = asyncio.Event()
        taken = under_test.gateway.take(frame_of_passage(make_passage(SECTION)), via="udp")
        assert taken.passage is not None
        receipt = asyncio.create_task(under_test.gateway.settle(taken.passage, via="udp"))
        for _ in range(20):
            await asyncio.sleep(0)
        assert not receipt.done()
        under_test.store.gate.set()
        assert read_replies(await receipt) == [Receipt(taken.passage.passage_id, Accepted())]

    asyncio.run(scenario())


def test_an_old_passage_is_told_that_it_does_not_count():
    passage = make_passage(SECTION, age_s=5000.0)
    (receipt,) = answers(make_unit(section=SECTION), frame_of_passage(passage))
    assert receipt == Receipt(passage.passage_id, Accepted(NotCounted.OLDER_THAN_WINDOW))


def test_sending_twice_changes_nothing_and_answers_the_same():
    under_test = make_unit(section=SECTION)
    passage = make_passage(SECTION)
    first = answers(under_test, frame_of_passage(passage))
    second = answers(under_test, frame_of_passage(replace(passage, age_s=3.0)))
    assert first == second
    assert len(under_test.store.entries) == 1


def test_more_passages_than_may_be_in_work_are_refused_as_busy():
    async def scenario():
        under_test = make_unit(section=SECTION, in_flight_limit_count=2)
        under_test.store.gate = asyncio.Event()
        passages = [make_passage(SECTION, seed=seed) for seed in range(3)]
        tasks = [asyncio.create_task(under_test.gateway.settle(p, via="udp")) for p in passages]
        await asyncio.sleep(0.01)
        under_test.store.gate.set()
        receipts = [read_replies(await task)[0] for task in tasks]
        outcomes = [r.outcome for r in receipts if isinstance(r, Receipt)]
        assert outcomes[:2] == [Accepted(), Accepted()]
        assert isinstance(outcomes[2], Rejected)
        assert outcomes[2].reason is Reason.BUSY

    asyncio.run(scenario())


def test_the_unit_sends_at_most_its_budget_in_one_passage_however_often_it_is_asked():
    under_test = make_unit(section=SECTION)
    sent_count = 0

    async def scenario():
        nonlocal sent_count
        for attempt in range(30):
            taken = under_test.gateway.take(arrival_frame(known="" if attempt % 2 else "0" * 16), via="udp")
            sent_count += sum(len(out.frames) for out in taken.replies)

    asyncio.run(scenario())
    assert 0 < sent_count <= RSU_FRAME_BUDGET - RECEIPTS_RESERVED_COUNT


def test_repeated_arrivals_leave_room_for_the_receipt():
    under_test = make_unit(section=SECTION)
    passage = make_passage(SECTION, passage_id=ID)
    for _ in range(30):
        answers(under_test, arrival_frame())
    assert answers(under_test, frame_of_passage(passage)) == [Receipt(ID, Accepted())]


def test_duplicates_use_up_nobodys_budget():
    under_test = make_unit(section=SECTION)
    for _ in range(3 * VEHICLE_FRAME_BUDGET):
        answers(under_test, arrival_frame())
    (receipt,) = answers(under_test, frame_of_passage(make_passage(SECTION, passage_id=ID)))
    assert receipt == Receipt(ID, Accepted())


def test_a_vehicle_that_sends_more_than_its_budget_is_refused():
    under_test = make_unit(section=SECTION)
    passage = make_passage(SECTION, passage_id=ID)
    for attempt in range(VEHICLE_FRAME_BUDGET):
        under_test.gateway.take(frame_of_passage(replace(passage, age_s=float(attempt))), via="udp")
    (receipt,) = answers(under_test, frame_of_passage(replace(passage, age_s=99.0)))
    assert isinstance(receipt, Receipt)
    assert isinstance(receipt.outcome, Rejected)
    assert receipt.outcome.reason is Reason.BUDGET_EXHAUSTED


def test_rejections_are_sent_so_many_a_second_and_all_counted():
    under_test = make_unit(section=SECTION, refusals_per_s=2.0)

    def refusals(count: int, start: int) -> int:
        frames = [
            arrival_frame(bytes([start + i]) * 16, section_id="elsewhere") for i in range(count)
        ]  # each an exchange of its own
        return sum(len(answers(under_test, frame)) for frame in frames)

    assert refusals(10, 0) == 2
    under_test.clock.advance(1.0)
    assert refusals(10, 100) == 2
    assert under_test.count("roadgrip_frames_dropped_total", via="udp", reason="unknown_section") == 20
    assert under_test.count("roadgrip_refusals_withheld_total") == 16


def test_a_flood_of_rubbish_does_not_flood_the_log():
    under_test = make_unit(section=SECTION)
    with capture_logs() as lines:
        for _ in range(500):
            answers(under_test, b"rubbish")
    assert 1 <= len([line for line in lines if line["event"] == "frame_refused"]) <= 5
    assert under_test.count("roadgrip_frames_dropped_total", via="udp", reason="malformed") == 500


def test_a_unit_that_is_told_to_send_no_rejections_sends_none():
    under_test = make_unit(section=SECTION, refusals_per_s=0.0)
    assert answers(under_test, arrival_frame(section_id="elsewhere")) == []


def test_what_other_units_say_is_dropped_in_silence():
    under_test = make_unit(section=SECTION)
    for out in (*under_test.gateway.beacons(), *under_test.gateway.guidance(SECTION.section_id)):
        for frame in out.frames:
            assert answers(under_test, frame) == []
    assert under_test.count("roadgrip_frames_dropped_total", via="udp", reason="not_for_units") >= 3


def test_a_beacon_announces_each_section():
    under_test = make_unit(section=SECTION)
    (beacon,) = read_replies(under_test.gateway.beacons())
    assert isinstance(beacon, Beacon)
    assert (beacon.section_id, beacon.map_version) == (SECTION.section_id, SECTION.version)


def test_answers_are_signed_where_there_is_a_key():
    under_test = make_unit(section=SECTION, signer=signer_of(Role.UNIT, section_ids=(SECTION.section_id,)))
    offer, notice = answers(under_test, arrival_frame(), verifier=VERIFIER)
    (receipt,) = answers(under_test, frame_of_passage(make_passage(SECTION)), verifier=VERIFIER)
    (beacon,) = read_replies(under_test.gateway.beacons(), verifier=VERIFIER)
    assert isinstance(offer, MapOffer)
    assert isinstance(notice, AdvisoryNotice)
    assert isinstance(receipt, Receipt)
    assert isinstance(beacon, Beacon)


def test_a_recorded_advisory_does_not_verify_in_the_exchange_of_another_vehicle():
    under_test = make_unit(section=SECTION, signer=UNIT)
    taken = under_test.gateway.take(arrival_frame(), via="udp")
    (recorded,) = (parse_frame(frame) for out in taken.replies if out.name == "advisory" for frame in out.frames)
    (forged,) = split_into_frames(
        recorded.kind, recorded.fragment, exchange_id=b"of today", section_key=recorded.section_key
    )
    with pytest.raises(WireError, match="signature"):
        read_frames([forged], verifier=VERIFIER)


def test_a_frame_about_another_section_than_its_message_is_refused():
    (frame,) = frames_of(Arrival(ID, SECTION.section_id), passage_id=ID, section_id="elsewhere")
    (receipt,) = answers(make_unit(section=SECTION), frame)
    assert isinstance(receipt, Receipt)
    assert isinstance(receipt.outcome, Rejected)
    assert receipt.outcome.reason is Reason.MALFORMED


@given(st.binary(max_size=200), st.booleans())
def test_no_bytes_make_the_gateway_raise(rubbish, begins_like_ours):
    head = arrival_frame()[: 28 if begins_like_ours else 0]
    taken = make_unit(section=SECTION).gateway.take(head + rubbish, via="udp")
    assert taken.passage is None


@given(st.integers(0, 10_000), st.integers(0, 255))
def test_no_flipped_byte_makes_the_gateway_accept_what_was_not_sent(at, value):
    under_test = make_unit(section=SECTION)
    frame = bytearray(frame_of_passage(make_passage(SECTION)))
    at %= len(frame)
    changed = frame[at] != value
    frame[at] = value
    taken = under_test.gateway.take(bytes(frame), via="udp")
    assert (taken.passage is None) is changed
