import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.errors import SectionError
from roadgrip.section_file import section_from_json, section_to_json
from tests.roadgrip.roads import PAPER_ROADS, circle_section, packaged, sections


@given(sections())
@settings(max_examples=30)
def test_a_section_survives_the_way_through_text(section):
    again = section_from_json(section_to_json(section))
    assert again.version == section.version
    assert again.nodes_m.tobytes() == section.nodes_m.tobytes()
    assert again.cross_slope_ratio.tobytes() == section.cross_slope_ratio.tobytes()
    assert (again.anchors, again.origin_m, again.bank_origin) == (
        section.anchors,
        section.origin_m,
        section.bank_origin,
    )
    assert section_to_json(again) == section_to_json(section)


@pytest.mark.parametrize("name", PAPER_ROADS)
def test_packaged_sections_are_named_for_their_files(name):
    assert packaged(name).section_id == name


def _raw():
    return json.loads(section_to_json(packaged("sharp-turn")))


def _without(key):
    def change(raw):
        del raw[key]

    return change


def _with(value, *path):
    def change(raw):
        for step in path[:-1]:
            raw = raw[step]
        raw[path[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (_without("speed_limit_mps"), "lacks speed_limit_mps"),
        (_without("nodes"), "lacks nodes"),
        (_with(1, "speed_limit_kmh"), "unknown speed_limit_kmh"),
        (_with(1, "nodes", 3, "w_m"), r"nodes\[3\] holds unknown w_m"),
        (_with("7", "nodes", 3, "x_m"), r"nodes\[3\].x_m is not a number"),
        (_with(True, "nodes", 0, "x_m"), r"nodes\[0\].x_m is not a number"),
        (_with(10**400, "nodes", 0, "x_m"), r"nodes\[0\].x_m is not a number of this world"),
        (_with({}, "anchors", 1), r"anchors\[1\] lacks"),
        (_with(None, "anchors"), "anchors is not a list"),
        (_with([], "origin"), "origin is not an object"),
        (_with("uphill", "direction"), "direction is 'uphill', not one of with, against"),
        (_with(7, "bank_origin"), "bank_origin is 7"),
        (_with(None, "name"), "name is not a text"),
        (_with(2, "format_version"), "roadgrip-section 2, this software reads"),
        (_with("other", "format"), "format is other"),
        (_with(33.0, "speed_limit_mps"), "version is .* delete the line"),
        (_with([], "nodes"), "nodes"),
        (_with([{}] * 1001, "nodes"), "1001 entries"),
    ],
)
def test_a_wrong_file_is_refused_with_the_place(change, told):
    raw = _raw()
    change(raw)
    with pytest.raises(SectionError, match=told):
        section_from_json(json.dumps(raw))


def test_the_version_may_be_left_out():
    raw = _raw()
    del raw["version"]
    assert section_from_json(json.dumps(raw)) == packaged("sharp-turn")


@pytest.mark.parametrize("text", ["", "{", "[]", "7", "null", "[" * 100_000, '{"a": NaN}', '{"a": 1, "a": 2}'])
def test_what_is_no_section_is_a_section_error(text):
    with pytest.raises(SectionError):
        section_from_json(text)


def test_infinities_and_nan_are_refused():
    text = section_to_json(circle_section())
    for bad in ("NaN", "Infinity", "-Infinity", "1e999"):
        with pytest.raises(SectionError, match="number"):
            section_from_json(text.replace('"x_m": 0.0', f'"x_m": {bad}', 1))


def test_a_text_of_unreasonable_length_is_not_even_parsed():
    with pytest.raises(SectionError, match="longer"):
        section_from_json(" " * 1_000_001)


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=5),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    ),
    st.data(),
)
@settings(max_examples=80)
def test_any_value_in_any_place_is_a_section_error_at_worst(value, data):
    raw = _raw()
    key = data.draw(st.sampled_from(sorted(raw)))
    raw[key] = value
    try:
        section_from_json(json.dumps(raw))
    except SectionError:
        pass
    else:
        assert key in {"name", "version", "crs", "section_id"} or raw[key] == _raw()[key]
