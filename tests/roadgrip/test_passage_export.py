from __future__ import annotations

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from roadgrip.passage_export import (
    TIME_STEP_S,
    ExportedPassage,
    ExportError,
    ExportHead,
    coarse_unix_s,
    head_from_json,
    head_to_json,
    passage_from_json,
    passage_to_json,
)

HEAD = ExportHead(
    unit="bend-7",
    exported_unix_s=1_767_268_800.0,
    since_unix_s=0.0,
    until_unix_s=1_767_268_800.0,
    sections_json={"v1": "{}"},
    bundle_id="0123456789abcdef",
    ledger_hash="a" * 64,
    software="0.1.0",
)
PASSAGE = ExportedPassage(
    section_id="bend",
    map_version="v1",
    table_digest="0" * 16,
    values=np.array([0.1, -2.0, 3e7], dtype=np.float32),
    duration_s=12.5,
    quality=3,
    left_unix_s=1_767_268_800.0,
    bundle_id="0123456789abcdef",
    mu=0.5,
    flags=0,
    expected_error_ratio=0.05,
    mu_low=0.4,
    at_least=False,
    shadow_bundle_id=None,
    shadow_mu=None,
)


def same(one: ExportedPassage, other: ExportedPassage) -> bool:
    plain = [f.name for f in fields(ExportedPassage) if f.name != "values"]
    return one.values.tobytes() == other.values.tobytes() and all(getattr(one, n) == getattr(other, n) for n in plain)


def test_a_head_survives_the_way_through_json():
    assert head_from_json(head_to_json(HEAD)) == HEAD


@given(arrays(np.float32, st.integers(0, 120)))
def test_values_survive_bit_by_bit(values):
    passage = replace(PASSAGE, values=values)
    assert same(passage_from_json(passage_to_json(passage)), passage)


def test_a_line_holds_nothing_that_names_a_vehicle():
    assert set(json.loads(passage_to_json(PASSAGE))) == {
        *(f.name for f in fields(ExportedPassage) if f.name != "values"),
        "values_base64_f4",
    }
    assert not any("passage_id" in f.name or "digest" in f.name for f in fields(ExportedPassage)[3:])


@given(st.floats(0.0, 4e9))
def test_moments_are_told_coarsely(unix_s):
    told = coarse_unix_s(unix_s)
    assert told % TIME_STEP_S == 0.0
    assert abs(told - unix_s) <= TIME_STEP_S / 2.0


@pytest.mark.parametrize("read", [head_from_json, passage_from_json])
@pytest.mark.parametrize("text", ["", "[]", "7", "null", "{", "{}", '{"format": "roadgrip-passages"}'])
def test_what_is_no_export_is_said_so(read, text):
    with pytest.raises(ExportError):
        read(text)


@pytest.mark.parametrize("key", [f.name for f in fields(ExportHead)])
@pytest.mark.parametrize("value", [None, [], {}, "x"])
def test_a_mangled_head_never_crashes(key, value):
    raw = json.loads(head_to_json(HEAD)) | {key: value}
    try:
        found = head_from_json(json.dumps(raw))
    except ExportError:
        return
    assert isinstance(found, ExportHead)


@pytest.mark.parametrize("key", [*(f.name for f in fields(ExportedPassage) if f.name != "values"), "values_base64_f4"])
@pytest.mark.parametrize("value", [None, [], {}, "x"])
def test_a_mangled_passage_never_crashes(key, value):
    raw = json.loads(passage_to_json(PASSAGE)) | {key: value}
    try:
        found = passage_from_json(json.dumps(raw))
    except ExportError:
        return
    assert isinstance(found, ExportedPassage)
