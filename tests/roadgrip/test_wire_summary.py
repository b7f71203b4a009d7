from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from roadgrip.cbor import strict_dumps, strict_loads
from roadgrip.errors import WireError
from roadgrip.protocol import Kind
from roadgrip.records import Accepted, NotCounted, Passage, Receipt
from roadgrip.wire import decode_message, encode_message
from roadgrip.wire_summary import summary_at_once, summary_from_fields
from tests.roadgrip.wire_samples import PASSAGE, passages

ENCODED = encode_message(PASSAGE)


def read_at_length(content: bytes) -> Passage | None:
    try:
        return summary_from_fields(strict_loads(content))
    except WireError:
        return None


@given(passages)
def test_a_faultless_summary_is_read_at_once_and_the_same_as_at_length(passage):
    content = encode_message(passage)
    assert summary_at_once(content) == summary_from_fields(strict_loads(content))


@given(passages, st.data())
def test_what_is_read_at_once_after_damage_is_what_is_read_at_length(passage, data):
    content = bytearray(encode_message(passage))
    for _ in range(data.draw(st.integers(1, 3))):
        # Mostly where heads and numbers are; a damaged statistic is another statistic.
        place = data.draw(st.one_of(st.integers(0, len(content) - 1), st.integers(-16, -1), st.integers(16, 72)))
        match data.draw(st.sampled_from(["change", "drop", "insert"])):
            case "change":
                content[place] = data.draw(st.integers(0, 255))
            case "drop":
                del content[place]
            case _:
                content.insert(place, data.draw(st.integers(0, 255)))
    at_once = summary_at_once(bytes(content))
    assert at_once is None or at_once == read_at_length(bytes(content))


@given(st.sampled_from([23, 24, 255, 256, 65_535, 65_536, 2**32 - 1, 2**32]), st.sampled_from([1, 2, 4, 8]))
def test_a_number_has_its_shortest_spelling_alone(age, width):
    fields = strict_loads(ENCODED)
    head = {1: b"\x18", 2: b"\x19", 4: b"\x1a", 8: b"\x1b"}[width]
    spelled = head + age.to_bytes(8, "big")[-width:]
    content = strict_dumps({**fields, 7: 0})[:-1] + spelled
    assert summary_at_once(content) == read_at_length(content)


@given(st.sampled_from(list(NotCounted)))
def test_an_acceptance_is_written_at_once_as_at_length(flags):
    receipt = Receipt(PASSAGE.passage_id, Accepted(flags))
    payload = encode_message(receipt)
    assert payload == strict_dumps({0: PASSAGE.passage_id, 1: int(flags)})
    assert decode_message(Kind.RECEIPT, payload) == receipt
