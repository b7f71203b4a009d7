from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.errors import WireError
from roadgrip.exchange import FROM_VEHICLE, message_of
from roadgrip.features import NEWEST_TABLE
from roadgrip.frames import Complete, exchange_id_of, parse_frame, section_key_of, split_into_frames
from roadgrip.records import Accepted, AdvisoryNotice, Arrival, MapOffer, Message, Passage, Reason, Receipt
from roadgrip.section import build_section
from roadgrip.wire import encode_message, kind_of
from tests.vehicle_client.shell.air import ADVICE, BEND, PASSAGE_ID, SUMMARY
from vehicle_client.shell.codec import WireCodec
from vehicle_client.shell.exchange import Ending, Exchange
from vehicle_client.shell.keys import Keys


def a_codec() -> WireCodec:
    return WireCodec(PASSAGE_ID, section_id="bend", timeout_s=10.0)


def from_unit(message: Message, *, passage_id: bytes = PASSAGE_ID) -> tuple[bytes, ...]:
    return split_into_frames(
        kind_of(message),
        encode_message(message),
        exchange_id=exchange_id_of(passage_id),
        section_key=section_key_of("bend"),
    )


def as_unit(frames: tuple[bytes, ...]) -> Message:
    (frame,) = map(parse_frame, frames)
    complete = Complete(frame.kind, frame.section_key, frame.exchange_id, frame.fragment)
    return message_of(complete, expected=FROM_VEHICLE).message


def test_an_announcement_is_one_frame_that_the_unit_reads():
    arrival = Arrival(PASSAGE_ID, "bend")
    assert as_unit(a_codec().frames_of(arrival)) == arrival


def a_large_map() -> MapOffer:
    along_m = np.arange(400) * 5.0
    road = build_section(
        section_id="bend",
        name="long",
        nodes_m=np.column_stack([along_m, 50.0 * np.sin(along_m / 90.0), 3.0 * np.sin(along_m / 70.0)]),
        speed_limit_mps=20.0,
    )
    return MapOffer(road, (NEWEST_TABLE.digest,))


def test_a_map_of_several_frames_comes_together_in_any_order():
    codec = a_codec()
    frames = from_unit(a_large_map())
    assert len(frames) > 1
    answers = [codec.message_of(frame, now_s=0.0) for frame in reversed(frames)]
    assert answers[:-1] == [None] * (len(frames) - 1)
    assert answers[-1] == a_large_map()


@pytest.mark.parametrize(("speedup_ratio", "whole"), [(1.0, False), (60.0, True)])
def test_the_pieces_of_a_map_have_their_time_on_the_wall(speedup_ratio: float, whole: bool):
    codec = Keys().codecs_for("bend", speedup_ratio=speedup_ratio)(PASSAGE_ID)
    first, *others = from_unit(a_large_map())
    codec.message_of(first, now_s=0.0)
    # Four minutes of a clock sixty times as fast are four seconds.
    answers = [codec.message_of(frame, now_s=240.0) for frame in others]
    assert (answers[-1] is not None) is whole


def test_frames_of_another_exchange_are_passed_over():
    receipt = Receipt(bytes(16), Accepted())
    (frame,) = from_unit(receipt, passage_id=bytes(16))
    assert a_codec().message_of(frame, now_s=0.0) is None


def test_a_message_that_flies_the_other_way_is_refused():
    (frame,) = a_codec().frames_of(Arrival(PASSAGE_ID, "bend"))
    with pytest.raises(WireError, match="other way"):
        a_codec().message_of(frame, now_s=0.0)


def test_a_spoiled_frame_is_refused():
    (frame,) = from_unit(Receipt(PASSAGE_ID, Accepted()))
    with pytest.raises(WireError) as refusal:
        a_codec().message_of(frame[:-1] + bytes([frame[-1] ^ 1]), now_s=0.0)
    assert refusal.value.reason is Reason.BAD_CHECKSUM


def test_an_exchange_speaks_the_wire_format():
    exchange = Exchange(passage_id=PASSAGE_ID, section_id="bend", codec=a_codec())
    assert as_unit(exchange.begin(now_s=0.0)) == Arrival(PASSAGE_ID, "bend")
    for message in (
        AdvisoryNotice("bend", BEND.version, ADVICE, issued_unix_s=0),
        MapOffer(BEND, (NEWEST_TABLE.digest,)),
    ):
        for frame in from_unit(message):
            exchange.receive(frame, now_s=0.1)
    assert exchange.section == BEND
    sent = as_unit(exchange.report(SUMMARY, map_version=BEND.version, left_at_s=30.0, now_s=31.5))
    assert isinstance(sent, Passage)
    assert sent.age_s == pytest.approx(1.5)
    assert sent == replace(
        Passage(PASSAGE_ID, "bend", BEND.version, sent.summary, 1.5),
        summary=replace(SUMMARY, values=tuple(float(np.float32(v)) for v in SUMMARY.values)),
    )
    (receipt,) = from_unit(Receipt(PASSAGE_ID, Accepted()))
    exchange.receive(receipt, now_s=31.6)
    assert exchange.record().ending is Ending.ACCEPTED
