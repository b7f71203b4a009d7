"""Liars: how far the median can be moved at all, and what gets past a unit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.lying.crafting import LIARS_COUNT, bounds_highest, crafted, names
from bench.lying.judged import Door, distinct
from bench.lying.windows import bounds_of_median_mu
from roadgrip.features import NEWEST_TABLE
from tests.bundles import CONFORMAL, make_manifest
from tests.rsu_app.fakes import FakeModel, make_passage, make_section

FRICTIONS = st.floats(0.05, 1.5)


@given(st.lists(FRICTIONS, min_size=5, max_size=40), st.lists(FRICTIONS, min_size=1, max_size=4))
def test_nothing_that_is_said_moves_the_median_further_than_its_bounds(honest, lies):
    low_mu, high_mu = bounds_of_median_mu(np.array(honest), liars_count=len(lies))
    assert low_mu - 1e-12 <= np.median(honest + lies) <= high_mu + 1e-12


def test_fifteen_of_fifty_reach_the_bounds_by_saying_the_least_and_the_most():
    honest = np.linspace(0.4, 0.5, 35)
    low_mu, high_mu = bounds_of_median_mu(honest, liars_count=15)
    assert np.median([*honest, *[0.1] * 15]) == pytest.approx(low_mu)
    assert np.median([*honest, *[1.4] * 15]) == pytest.approx(high_mu)


@pytest.fixture
def door():
    """Its model answers 0.5 plus the mean sideslip, and expects an error of 5 % plus the mean steering angle."""
    model = FakeModel(make_manifest(model=b"a fake has no file", conformal=CONFORMAL))
    return Door(make_section(), NEWEST_TABLE, model)


def drives(door, count=60):
    """Drives from which the model reads 0.4 to 0.6."""
    friction_mu = np.linspace(0.4, 0.6, count).tolist()
    passages = [make_passage(door.section, seed=seed, mu=mu) for seed, mu in enumerate(friction_mu)]
    return np.array([passage.summary.values for passage in passages])


def test_liars_find_what_they_want_to_claim_and_count(door, rng):
    honest = door.counted(drives(door))
    assert len(honest) == 60
    lie = crafted(door, honest, names(0.53), name="0.53", rng=rng)
    assert lie is not None
    counts, said = door.judge(lie.said.values)
    assert counts.all()
    assert said.mu == pytest.approx(np.full(LIARS_COUNT, 0.53), abs=0.01)
    assert len(distinct(lie.said)) == LIARS_COUNT
    assert not said.at_least.any()


def test_what_breaks_the_laws_of_statistics_does_not_get_past_the_door(door):
    rows = drives(door, 3)
    rows[1, NEWEST_TABLE.index("sideslip_min_rad")] = 1.5
    assert door.judge(rows)[0].tolist() == [True, False, True]


def test_nobody_says_at_least_where_all_are_sure(door, rng):
    assert crafted(door, door.counted(drives(door)), bounds_highest, name="", rng=rng) is None
