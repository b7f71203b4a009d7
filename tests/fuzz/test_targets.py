"""Every parser keeps its promise for good inputs, for what was found before, and for inputs with a few damages."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fuzz.seeds import CORPUS_FOLDER, seeds
from tests.fuzz.targets import TARGETS

damages = st.lists(st.tuples(st.integers(0, 2**16), st.integers(0, 12), st.binary(max_size=6)), min_size=1, max_size=4)


def damaged(data: bytes, changes: list[tuple[int, int, bytes]]) -> bytes:
    """Each change takes some bytes away at a place and puts others there."""
    for place, taken_count, put in changes:
        at = place % (len(data) + 1)
        data = data[:at] + put + data[at + taken_count :]
    return data


@pytest.mark.parametrize("name", TARGETS)
def test_good_inputs_and_findings_of_the_past(name):
    for data in seeds()[name]:
        TARGETS[name].check(data)


@pytest.mark.parametrize("name", TARGETS)
@settings(max_examples=40)
@given(data=st.data())
def test_damaged_inputs(name, data):
    seed = data.draw(st.sampled_from(range(len(seeds()[name]))))
    TARGETS[name].check(damaged(seeds()[name][seed], data.draw(damages))[: TARGETS[name].limit_bytes])


@pytest.mark.parametrize("name", TARGETS)
@settings(max_examples=40)
@given(data=st.binary(max_size=300))
def test_any_bytes(name, data):
    TARGETS[name].check(data)


def test_the_kept_corpus_is_small_and_of_targets_there_are():
    files = [path for path in CORPUS_FOLDER.rglob("*") if path.is_file()]
    assert {path.parent.name for path in files} <= set(TARGETS)
    assert sum(path.stat().st_size for path in files) < 20_000
    assert all(path.parent.parent == Path(CORPUS_FOLDER) for path in files)
