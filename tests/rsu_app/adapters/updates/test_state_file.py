import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsu_app.adapters.updates.state_file import StateFileError, state_from_json, state_to_json
from rsu_app.domain.rollout import FACTORY, RolloutState, ShelvedBundle, Stage

HEX = "0123456789abcdef"
BUNDLES = st.builds(
    ShelvedBundle,
    bundle_id=st.text(HEX, min_size=16, max_size=16),
    manifest_sha256=st.text(HEX, min_size=64, max_size=64),
    sequence_number=st.integers(1, 10**12),
    ledger_hash=st.text(max_size=64),
    gate=st.sampled_from(["passed", "overridden", "none"]),
)
STATE = RolloutState(
    live=ShelvedBundle("a" * 16, "b" * 64, 7, "c" * 64, "passed"), previous=FACTORY, newest_sequence_number=8
)


@st.composite
def states(draw):
    stage = draw(st.sampled_from(Stage))
    live = draw(st.just(FACTORY) | BUNDLES)
    held = st.just(FACTORY) | BUNDLES
    previous = draw(held if stage is Stage.PROBATION else st.none() | held)
    candidate = draw(BUNDLES) if stage is Stage.SHADOW else None
    newest = max(each.sequence_number for each in (live, previous, candidate) if each is not None)
    return RolloutState(live, previous, candidate, stage, newest + draw(st.integers(0, 5)))


@given(states())
def test_a_state_comes_back_as_it_was(state):
    assert state_from_json(state_to_json(state)) == state


def changed(path, value):
    raw = json.loads(state_to_json(STATE))
    *above, last = path
    place = raw
    for key in above:
        place = place[key]
    place[last] = value
    return json.dumps(raw)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        "{}",
        "[" * 100_000,
        changed(["format_version"], 2),
        changed(["another"], 1),
        changed(["live", "another"], 1),
        changed(["live"], None),
        changed(["live", "bundle_id"], "../../etc"),
        changed(["live", "bundle_id"], "factory"),
        changed(["live", "manifest_sha256"], "b" * 63),
        changed(["live", "manifest_sha256"], "/" * 64),
        changed(["live", "sequence_number"], -1),
        changed(["live", "sequence_number"], True),
        changed(["live", "sequence_number"], 7.0),
        changed(["live", "sequence_number"], "7"),
        changed(["live", "gate"], None),
        changed(["previous", "manifest_sha256"], "b" * 64),
        changed(["stage"], "elsewhere"),
    ],
)
def test_what_is_no_state_is_refused(text):
    with pytest.raises(StateFileError):
        state_from_json(text)


@pytest.mark.parametrize(
    "text",
    [
        changed(["stage"], "shadow"),
        changed(["candidate"], json.loads(state_to_json(STATE))["live"]),
        changed(["newest_sequence_number"], 6),
        json.dumps(json.loads(changed(["stage"], "probation")) | {"previous": None}),
    ],
)
def test_a_state_that_contradicts_itself_is_refused(text):
    with pytest.raises(StateFileError):
        state_from_json(text)


@given(states(), st.data())
def test_half_a_file_is_refused(state, data):
    text = state_to_json(state)
    # The last character is a line feed, which nobody misses.
    with pytest.raises(StateFileError):
        state_from_json(text[: data.draw(st.integers(0, len(text) - 2))])
