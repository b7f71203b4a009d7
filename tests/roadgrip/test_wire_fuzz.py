"""Whatever bytes come, they are a message in its only spelling or a WireError."""

import cbor2
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from roadgrip.errors import WireError
from roadgrip.reasons import Reason
from roadgrip.wire import Kind, decode_message, encode_message, kind_of
from tests.roadgrip.wire_samples import SAMPLES, fields_of, reason_for


@given(st.sampled_from(Kind), st.binary(max_size=2000))
@example(Kind.MAP, b"\x9f" * 2000)
@example(Kind.SUMMARY, b"\xd2" * 50)
def test_random_bytes_are_refused(kind, payload):
    with pytest.raises(WireError):
        decode_message(kind, payload)


@given(
    st.sampled_from(sorted(SAMPLES)),
    st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), min_size=1, max_size=6),
    st.one_of(st.none(), st.integers(0, 10_000)),
)
def test_a_damaged_message_is_refused_or_is_another_message_in_its_only_spelling(name, damages, cut):
    payload = bytearray(encode_message(SAMPLES[name]))
    for position, byte in damages:
        payload[position % len(payload)] = byte
    damaged = bytes(payload if cut is None else payload[: cut % (len(payload) + 1)])
    kind = kind_of(SAMPLES[name])
    try:
        message = decode_message(kind, damaged)
    except WireError:
        return
    assert encode_message(message) == damaged


cbor_values = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(-(2**64), 2**64),
        st.floats(),
        st.binary(max_size=20),
        st.text(st.characters(codec="utf-8"), max_size=10),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.integers(0, 20), inner, max_size=4),
        st.builds(cbor2.CBORTag, st.sampled_from([0, 1, 2, 4, 18, 35, 77, 78, 85, 258]), inner),
    ),
    max_leaves=8,
)


cbor_keys = st.one_of(
    st.integers(0, 14),
    st.booleans(),
    st.integers(0, 14).map(float),
    st.integers(0, 14).map(cbor2.CBORSimpleValue),
)


@given(st.sampled_from(sorted(SAMPLES)), st.data())
def test_a_key_that_only_equals_the_right_one_is_refused(name, data):
    fields = fields_of(SAMPLES[name])
    key = data.draw(st.sampled_from(sorted(fields)))
    twin = data.draw(st.sampled_from([float(key), cbor2.CBORSimpleValue(key), *([bool(key)] if key < 2 else [])]))
    spelt = {twin if k == key else k: v for k, v in fields.items()}
    assert reason_for(kind_of(SAMPLES[name]), cbor2.dumps(spelt, canonical=True)) is Reason.MALFORMED


@given(st.sampled_from(sorted(SAMPLES)), st.dictionaries(cbor_keys, cbor_values, min_size=1, max_size=3))
def test_strange_fields_are_refused_or_are_another_message_in_its_only_spelling(name, changes):
    payload = cbor2.dumps({**fields_of(SAMPLES[name]), **changes}, canonical=True)
    try:
        message = decode_message(kind_of(SAMPLES[name]), payload)
    except WireError:
        return
    assert encode_message(message) == payload
