from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.features import NEWEST_TABLE
from roadgrip.records import (
    VEHICLE_FRAME_BUDGET,
    Accepted,
    AdvisoryNotice,
    Arrival,
    MapOffer,
    Message,
    NotCounted,
    Outcome,
    Passage,
    Reason,
    Receipt,
    Rejected,
)
from roadgrip.section import RoadSection
from tests.vehicle_client.shell.air import ADVICE, BEND, PASSAGE_ID, SUMMARY, Air, Ether, Fate, TokenCodec, Unit, bend
from vehicle_client.shell.exchange import Ending, Exchange, ExchangeRecord, Stage
from vehicle_client.shell.patience import Patience

LOST = Fate.LOST


def an_exchange(ether: Ether, *, known: RoadSection | None = None, spent: int = 0) -> Exchange:
    return Exchange(
        passage_id=PASSAGE_ID,
        section_id="bend",
        codec=TokenCodec(ether),
        known_section=known,
        frames_spent_count=spent,
    )


def hear(exchange: Exchange, ether: Ether, message: Message, *, now_s: float) -> None:
    """Let a message of one frame reach a vehicle."""
    (frame,) = ether.put(message)
    exchange.receive(frame, now_s=now_s)


def a_passage(
    fates: Iterable[Fate] = (), *, outcomes: Iterable[Outcome] = (Accepted(),), frames_per_message: int = 1
) -> tuple[ExchangeRecord, Air]:
    """Play a whole passage of 30 s."""
    ether = Ether(frames_per_message)
    exchange = an_exchange(ether)
    air = Air(exchange, Unit(TokenCodec(ether), outcomes=list(outcomes)), iter(fates))
    air.send(exchange.begin(now_s=0.0), up=True)
    air.play(limit_s=30.0)
    air.now_s = 30.0
    if exchange.section is None:
        exchange.withhold(Reason.WRONG_ROAD)
    else:
        air.send(
            exchange.report(SUMMARY, map_version=exchange.section.version, left_at_s=29.0, now_s=air.now_s), up=True
        )
        air.play(until=Stage.ENDED)
    return exchange.record(), air


def test_a_clean_exchange_costs_the_vehicle_two_frames_and_the_unit_three():
    record, air = a_passage()
    assert (record.ending, record.outcome) == (Ending.ACCEPTED, Accepted())
    assert (record.frames_sent_count, record.frames_received_count) == (2, 3)
    assert record.advisory == ADVICE
    assert record.map_version == BEND.version
    assert [type(m) for m in air.unit.heard] == [Arrival, Passage]


def test_a_vehicle_that_has_the_map_asks_for_the_advisory_only():
    ether = Ether()
    exchange = an_exchange(ether, known=BEND)
    air = Air(exchange, Unit(TokenCodec(ether)), iter(()))
    air.send(exchange.begin(now_s=0.0), up=True)
    air.play(until=Stage.DRIVING)
    assert exchange.record().frames_received_count == 1
    assert exchange.section == BEND


def test_a_vehicle_with_an_old_map_gets_the_new_one():
    ether = Ether()
    exchange = an_exchange(ether, known=bend(speed_limit_mps=22.0))
    air = Air(exchange, Unit(TokenCodec(ether)), iter(()))
    air.send(exchange.begin(now_s=0.0), up=True)
    air.play(until=Stage.DRIVING)
    assert exchange.section == BEND


def test_an_advisory_for_another_map_makes_the_vehicle_ask_for_that_map():
    exchange = an_exchange(ether := Ether(), known=BEND)
    exchange.begin(now_s=0.0)
    hear(exchange, ether, AdvisoryNotice("bend", "another-version", ADVICE, issued_unix_s=0), now_s=0.1)
    (again,) = exchange.tick(now_s=1.0)
    assert ether.cargo[again][2] == Arrival(PASSAGE_ID, "bend", known_map_version="")


@pytest.mark.parametrize("map_first", [True, False])
def test_a_vehicle_drives_once_it_has_map_and_advisory_whichever_comes_first(map_first: bool):
    exchange = an_exchange(ether := Ether())
    exchange.begin(now_s=0.0)
    answers: list[Message] = [
        MapOffer(BEND, (NEWEST_TABLE.digest,)),
        AdvisoryNotice("bend", BEND.version, ADVICE, issued_unix_s=0),
    ]
    stages = []
    for message in answers if map_first else reversed(answers):
        hear(exchange, ether, message, now_s=0.1)
        stages.append(exchange.stage)
    assert stages == [Stage.ARRIVING, Stage.DRIVING]
    assert exchange.wake_at_s == inf


def test_advice_on_the_way_for_another_map_does_not_take_the_map_from_a_vehicle_that_drives_by_it():
    exchange = an_exchange(ether := Ether(), known=BEND)
    exchange.begin(now_s=0.0)
    hear(exchange, ether, AdvisoryNotice("bend", BEND.version, ADVICE, issued_unix_s=0), now_s=0.1)
    slower = replace(ADVICE, speed_mps=11.11)
    hear(exchange, ether, AdvisoryNotice("bend", "another-version", slower, issued_unix_s=0), now_s=5.0)
    assert exchange.section == BEND
    assert exchange.advisory == slower


def test_map_and_advice_that_come_after_the_summary_change_nothing():
    exchange = an_exchange(ether := Ether(), known=BEND)
    exchange.report(SUMMARY, map_version=BEND.version, left_at_s=0.0, now_s=0.0)
    newer = bend(speed_limit_mps=22.0)
    hear(exchange, ether, MapOffer(newer, (NEWEST_TABLE.digest,)), now_s=0.1)
    hear(exchange, ether, AdvisoryNotice("bend", newer.version, ADVICE, issued_unix_s=0), now_s=0.1)
    assert (exchange.section, exchange.advisory) == (BEND, None)
    assert exchange.record().messages_ignored_count == 2


def test_nothing_is_sent_before_its_time():
    exchange = an_exchange(Ether())
    exchange.begin(now_s=0.0)
    assert exchange.tick(now_s=0.49) == ()
    assert len(exchange.tick(now_s=0.5)) == 1


def test_an_announcement_leaves_a_frame_for_the_summary():
    exchange = an_exchange(Ether(), known=BEND, spent=VEHICLE_FRAME_BUDGET - 1)
    assert exchange.begin(now_s=0.0) == ()
    assert exchange.stage is Stage.DRIVING
    assert len(exchange.report(SUMMARY, map_version=BEND.version, left_at_s=9.0, now_s=10.0)) == 1


def test_a_section_that_ends_after_now_by_the_estimate_gives_an_age_of_zero():
    exchange = an_exchange(ether := Ether(), known=BEND)
    (frame,) = exchange.report(SUMMARY, map_version=BEND.version, left_at_s=10.02, now_s=10.0)
    assert ether.cargo[frame][2] == Passage(PASSAGE_ID, "bend", BEND.version, SUMMARY, age_s=0.0)


def test_the_age_is_encoded_anew_for_every_try():
    # The summary is lost twice; map and advisory took the first three fates.
    _, air = a_passage([Fate.ARRIVES] * 3 + [LOST, LOST])
    (heard,) = [m for m in air.unit.heard if isinstance(m, Passage)]
    assert heard.age_s == pytest.approx(1.0 + 0.5 + 1.5)


def test_without_any_answer_the_vehicle_gives_up_within_its_tries_and_may_spool():
    ether = Ether()
    exchange = an_exchange(ether, known=BEND)
    air = Air(exchange, Unit(TokenCodec(ether)), iter([LOST] * 99))
    air.send(exchange.begin(now_s=0.0), up=True)
    air.play(until=Stage.DRIVING)
    assert exchange.stage is Stage.DRIVING
    air.send(exchange.report(SUMMARY, map_version=BEND.version, left_at_s=29.0, now_s=30.0), up=True)
    air.play(until=Stage.ENDED)
    record = exchange.record()
    assert record.ending is Ending.UNANSWERED
    assert record.may_spool
    assert (record.arrival_tries_count, record.report_tries_count, record.frames_sent_count) == (4, 5, 9)


def test_a_vehicle_that_never_got_the_map_sends_no_summary():
    record, air = a_passage([LOST] * 4)
    assert (record.ending, record.withheld) == (Ending.NO_MAP, None)
    assert not record.may_spool
    assert air.unit.heard == []


def test_a_refusal_for_now_is_tried_again_later():
    record, air = a_passage(outcomes=[Rejected(Reason.BUSY), Rejected(Reason.NO_MODEL), Accepted()])
    assert record.ending is Ending.ACCEPTED
    assert record.report_tries_count == 3
    assert air.now_s > 30.0 + 2.0 + 6.0


def test_a_unit_that_stays_busy_leaves_the_passage_to_the_spool():
    record, _ = a_passage(outcomes=[Rejected(Reason.BUSY)])
    assert record.ending is Ending.POSTPONED
    assert record.may_spool
    assert record.outcome == Rejected(Reason.BUSY)


def test_a_refusal_for_good_ends_the_exchange():
    record, _ = a_passage(outcomes=[Rejected(Reason.STALE_MAP, "newer map")])
    assert record.ending is Ending.REJECTED
    assert not record.may_spool
    assert record.report_tries_count == 1


def test_an_accepted_passage_that_is_not_counted_ends_the_exchange_too():
    record, _ = a_passage(outcomes=[Accepted(NotCounted.OUT_OF_ENVELOPE)])
    assert record.ending is Ending.ACCEPTED
    assert record.outcome == Accepted(NotCounted.OUT_OF_ENVELOPE)


def test_a_spooled_summary_spends_what_is_left_of_the_budget():
    ether = Ether()
    exchange = an_exchange(ether, spent=VEHICLE_FRAME_BUDGET - 2)
    air = Air(exchange, Unit(TokenCodec(ether)), iter([LOST] * 99))
    air.send(exchange.report(SUMMARY, map_version=BEND.version, left_at_s=0.0, now_s=900.0), up=True)
    air.play(until=Stage.ENDED)
    assert air.sent_count == 2
    assert exchange.record().frames_sent_count == VEHICLE_FRAME_BUDGET


def test_a_message_larger_than_what_is_left_is_not_begun():
    ether = Ether(frames_per_message=3)
    exchange = an_exchange(ether, spent=VEHICLE_FRAME_BUDGET - 2)
    assert exchange.report(SUMMARY, map_version=BEND.version, left_at_s=0.0, now_s=900.0) == ()
    assert exchange.record().ending is Ending.UNANSWERED


@pytest.mark.parametrize("known", [None, BEND])
def test_nothing_is_sent_to_a_unit_whose_model_serves_another_feature_table(known: RoadSection | None):
    exchange = an_exchange(ether := Ether(), known=known)
    exchange.begin(now_s=0.0)
    hear(exchange, ether, MapOffer(BEND, ("another-table",)), now_s=0.1)
    assert exchange.report(SUMMARY, map_version=BEND.version, left_at_s=9.0, now_s=10.0) == ()
    record = exchange.record()
    assert (record.ending, record.withheld) == (Ending.WITHHELD, Reason.WRONG_FEATURE_TABLE)


def test_a_withheld_summary_says_why():
    exchange = an_exchange(Ether(), known=BEND)
    exchange.begin(now_s=0.0)
    exchange.withhold(Reason.TOO_SHORT)
    assert (exchange.record().ending, exchange.record().withheld) == (Ending.WITHHELD, Reason.TOO_SHORT)


def test_what_is_meant_for_somebody_else_changes_nothing():
    ether = Ether()
    exchange = an_exchange(ether)
    exchange.begin(now_s=0.0)
    foreign: list[Message] = [
        MapOffer(bend("elsewhere"), (NEWEST_TABLE.digest,)),
        AdvisoryNotice("elsewhere", BEND.version, ADVICE, issued_unix_s=0),
        Receipt(bytes(16), Accepted()),
        Receipt(PASSAGE_ID, Accepted()),  # nothing was reported yet
        Arrival(bytes(16), "bend"),
    ]
    for message in foreign:
        hear(exchange, ether, message, now_s=0.1)
    assert exchange.stage is Stage.ARRIVING
    assert exchange.section is None
    assert exchange.advisory is None
    assert exchange.record().messages_ignored_count == len(foreign)


def test_a_duplicate_of_a_busy_receipt_does_not_push_the_next_try_away():
    exchange = an_exchange(ether := Ether(), known=BEND)
    exchange.report(SUMMARY, map_version=BEND.version, left_at_s=0.0, now_s=0.0)
    for now_s in (0.1, 1.9):
        hear(exchange, ether, Receipt(PASSAGE_ID, Rejected(Reason.BUSY)), now_s=now_s)
    assert exchange.wake_at_s == pytest.approx(2.1)


def test_a_unit_that_does_not_know_the_section_ends_the_exchange_before_the_drive():
    exchange = an_exchange(ether := Ether())
    exchange.begin(now_s=0.0)
    hear(exchange, ether, Receipt(PASSAGE_ID, Rejected(Reason.UNKNOWN_SECTION)), now_s=0.1)
    assert exchange.record().ending is Ending.REJECTED


def test_a_refusal_of_an_unread_message_ends_nothing_since_any_listener_could_forge_it():
    exchange = an_exchange(ether := Ether(), known=BEND)
    exchange.report(SUMMARY, map_version=BEND.version, left_at_s=0.0, now_s=0.0)
    hear(exchange, ether, Receipt(PASSAGE_ID[:8] + bytes(8), Rejected(Reason.UNSIGNED)), now_s=0.1)
    assert exchange.stage is Stage.REPORTING
    hear(exchange, ether, Receipt(PASSAGE_ID, Accepted()), now_s=0.2)
    assert exchange.record().ending is Ending.ACCEPTED


def test_when_every_try_is_refused_unread_the_reason_is_told():
    exchange = an_exchange(ether := Ether(), known=BEND)
    exchange.report(SUMMARY, map_version=BEND.version, left_at_s=0.0, now_s=0.0)
    while exchange.stage is Stage.REPORTING:
        unread = Receipt(PASSAGE_ID[:8] + bytes(8), Rejected(Reason.UNSIGNED))
        hear(exchange, ether, unread, now_s=exchange.wake_at_s)
        exchange.tick(now_s=exchange.wake_at_s)
    record = exchange.record()
    assert (record.ending, record.outcome) == (Ending.REJECTED, Rejected(Reason.UNSIGNED))
    assert record.report_tries_count == 5


def test_a_vehicle_without_a_map_that_was_told_why_ends_refused_for_that_reason():
    exchange = an_exchange(ether := Ether())
    exchange.begin(now_s=0.0)
    (unread,) = ether.put(Receipt(PASSAGE_ID[:8] + bytes(8), Rejected(Reason.UNSIGNED)))
    exchange.receive(unread, now_s=0.1)
    exchange.withhold(Reason.PASSAGE_ABORTED)
    record = exchange.record()
    assert (record.ending, record.outcome) == (Ending.REJECTED, Rejected(Reason.UNSIGNED))


def test_withholding_leaves_an_exchange_that_has_ended_as_it_is():
    exchange = an_exchange(ether := Ether())
    exchange.begin(now_s=0.0)
    (frame,) = ether.put(Receipt(PASSAGE_ID, Rejected(Reason.UNKNOWN_SECTION)))
    exchange.receive(frame, now_s=0.1)
    exchange.withhold(Reason.PASSAGE_ABORTED)
    assert exchange.record().ending is Ending.REJECTED


def test_a_forged_acceptance_of_an_unread_message_is_ignored():
    exchange = an_exchange(ether := Ether(), known=BEND)
    exchange.report(SUMMARY, map_version=BEND.version, left_at_s=0.0, now_s=0.0)
    hear(exchange, ether, Receipt(PASSAGE_ID[:8] + bytes(8), Accepted()), now_s=0.1)
    assert exchange.stage is Stage.REPORTING
    assert exchange.record().outcome is None


def test_what_a_unit_says_after_the_end_changes_nothing():
    exchange = an_exchange(ether := Ether(), known=BEND)
    exchange.report(SUMMARY, map_version=BEND.version, left_at_s=0.0, now_s=0.0)
    hear(exchange, ether, Receipt(PASSAGE_ID, Accepted()), now_s=0.1)
    hear(exchange, ether, Receipt(PASSAGE_ID, Rejected(Reason.STALE_MAP)), now_s=0.2)
    record = exchange.record()
    assert (record.ending, record.outcome, record.messages_ignored_count) == (Ending.ACCEPTED, Accepted(), 1)


def test_a_spoiled_frame_is_counted_and_changes_nothing():
    exchange = an_exchange(Ether())
    exchange.begin(now_s=0.0)
    exchange.receive(b"spoiled", now_s=0.1)
    record = exchange.record()
    assert exchange.stage is Stage.ARRIVING
    assert (record.frames_received_count, record.frames_refused_count, record.messages_ignored_count) == (1, 1, 0)


def test_an_exchange_begins_once_and_reports_once():
    exchange = an_exchange(Ether(), known=BEND)
    exchange.begin(now_s=0.0)
    with pytest.raises(ValueError, match="begins once"):
        exchange.begin(now_s=0.0)
    exchange.report(SUMMARY, map_version=BEND.version, left_at_s=0.0, now_s=0.0)
    with pytest.raises(ValueError, match="reported once"):
        exchange.report(SUMMARY, map_version=BEND.version, left_at_s=0.0, now_s=0.0)
    with pytest.raises(ValueError, match="already been sent"):
        exchange.withhold(Reason.TOO_SHORT)


def test_stretched_patience_keeps_its_counts():
    stretched = Patience().stretched(60.0)
    assert (stretched.reply_s, stretched.longest_s, stretched.postpone_s) == pytest.approx((30.0, 360.0, 120.0))
    assert replace(stretched, reply_s=0.5, longest_s=6.0, postpone_s=2.0) == Patience()


def test_waits_grow_and_stop_growing():
    patience = Patience(reply_s=0.5, backoff_ratio=2.0, longest_s=3.0)
    assert [patience.wait_s(0.5, tries_count=n) for n in (1, 2, 3, 4, 5)] == [0.5, 1.0, 2.0, 3.0, 3.0]


def test_no_wait_is_shorter_than_the_first():
    assert [Patience(longest_s=6.0).wait_s(8.0, tries_count=n) for n in (1, 2, 3)] == [8.0, 8.0, 8.0]


fates = st.lists(st.sampled_from(Fate), max_size=60)
outcomes = st.lists(
    st.sampled_from(
        [Rejected(Reason.BUSY), Rejected(Reason.STORE_UNAVAILABLE), Rejected(Reason.STALE_MAP), Accepted()]
    ),
    min_size=1,
    max_size=6,
)


@given(fates=fates, outcomes=outcomes, frames_per_message=st.integers(1, 4))
def test_whatever_the_air_does_the_budget_holds_and_the_exchange_ends(
    fates: list[Fate], outcomes: list[Outcome], frames_per_message: int
):
    record, air = a_passage(fates, outcomes=outcomes, frames_per_message=frames_per_message)
    assert air.sent_count == record.frames_sent_count <= VEHICLE_FRAME_BUDGET
    assert air.exchange.stage is Stage.ENDED
    assert air.exchange.wake_at_s == inf
    if record.ending is Ending.ACCEPTED:
        assert air.unit.stored[PASSAGE_ID] == record.outcome == Accepted()
    if record.ending is Ending.REJECTED:
        assert record.outcome == air.unit.stored[PASSAGE_ID]


@given(fates=st.lists(st.sampled_from([Fate.ARRIVES, Fate.TWICE, Fate.LATE]), max_size=40))
def test_duplicates_and_delays_never_cost_a_passage(fates: list[Fate]):
    record, air = a_passage(fates)
    assert record.ending is Ending.ACCEPTED
    assert list(air.unit.stored) == [PASSAGE_ID]


@given(lost=st.sets(st.integers(0, 12), max_size=2))
def test_two_lost_frames_never_cost_a_passage(lost: set[int]):
    record, _ = a_passage([LOST if i in lost else Fate.ARRIVES for i in range(13)])
    assert record.ending is Ending.ACCEPTED


def driving(ether: Ether) -> Exchange:
    """Return an exchange that knows its map and has had advice."""
    exchange = an_exchange(ether, known=BEND)
    exchange.begin(now_s=0.0)
    hear(exchange, ether, AdvisoryNotice("bend", BEND.version, ADVICE, issued_unix_s=7), now_s=0.1)
    assert exchange.stage is Stage.DRIVING
    return exchange


def test_advice_is_asked_for_anew_until_the_announcements_are_spent():
    ether = Ether()
    exchange = driving(ether)
    for issued_s in (8, 9, 10):
        (frame,) = exchange.renew(now_s=float(issued_s))
        _, _, arrival = ether.cargo[frame]
        assert isinstance(arrival, Arrival)
        assert arrival.known_map_version == BEND.version
        hear(exchange, ether, AdvisoryNotice("bend", BEND.version, ADVICE, issued_unix_s=issued_s), now_s=issued_s)
        assert exchange.stage is Stage.DRIVING
    assert not exchange.renew(now_s=20.0)
    assert exchange.stage is Stage.DRIVING
    assert exchange.report(SUMMARY, map_version=BEND.version, left_at_s=20.0, now_s=21.0)


def test_advice_that_is_played_again_does_not_count_as_fresh():
    ether = Ether()
    exchange = driving(ether)
    first = exchange.notice
    exchange.renew(now_s=10.0)
    hear(exchange, ether, AdvisoryNotice("bend", BEND.version, ADVICE, issued_unix_s=7), now_s=10.1)
    assert exchange.notice is first
    assert exchange.stage is Stage.ARRIVING


def test_a_unit_without_a_clock_may_say_the_same_again_when_asked_and_only_then():
    ether = Ether()
    exchange = an_exchange(ether, known=BEND)
    exchange.begin(now_s=0.0)
    notices = [AdvisoryNotice("bend", BEND.version, ADVICE, issued_unix_s=0) for _ in range(3)]
    hear(exchange, ether, notices[0], now_s=0.1)
    hear(exchange, ether, notices[1], now_s=0.2)
    assert exchange.notice is notices[0]
    exchange.renew(now_s=10.0)
    hear(exchange, ether, notices[2], now_s=10.1)
    assert exchange.notice is notices[2]
    assert exchange.stage is Stage.DRIVING


@pytest.mark.parametrize("spent", range(VEHICLE_FRAME_BUDGET + 1))
def test_what_was_reserved_is_never_exceeded(spent: int):
    ether = Ether()
    exchange = an_exchange(ether, spent=spent)
    reserved = exchange.reserve()
    assert reserved == min(VEHICLE_FRAME_BUDGET, spent + Patience().report_tries_count)
    exchange.report(SUMMARY, map_version=BEND.version, left_at_s=0.0, now_s=0.0)
    for now_s in range(0, 200, 10):
        exchange.tick(now_s=float(now_s))
    assert exchange.stage is Stage.ENDED
    assert exchange.frames_sent_count == reserved
