from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsu_app.domain.rollout import (
    FACTORY,
    RolloutState,
    ShelvedBundle,
    Stage,
    confirmed,
    installed,
    rejected,
    rolled_back,
    switched,
    takes_up,
)


def bundle(number: int, bundle_id: str | None = None) -> ShelvedBundle:
    return ShelvedBundle(bundle_id or f"{number:016x}", "a" * 64, number, "b" * 64, "passed")


def test_a_unit_starts_with_the_bundle_of_the_factory():
    assert RolloutState().live == FACTORY
    assert RolloutState().needed_ids == frozenset()


def test_a_release_goes_through_shadow_and_probation_and_is_settled():
    state = installed(RolloutState(), bundle(1))
    assert (state.stage, state.live, state.candidate) == (Stage.SHADOW, FACTORY, bundle(1))
    state = switched(state)
    assert (state.stage, state.live, state.previous, state.candidate) == (Stage.PROBATION, bundle(1), FACTORY, None)
    state = confirmed(state)
    assert (state.stage, state.live, state.previous) == (Stage.SETTLED, bundle(1), FACTORY)


def test_a_candidate_that_fails_is_forgotten_and_its_release_never_taken_again():
    state = rejected(installed(RolloutState(), bundle(3)))
    assert state == RolloutState(newest_sequence_number=3)
    assert not takes_up(state, 3)
    assert takes_up(state, 4)


def test_the_step_back_leads_to_the_bundle_before_and_not_further():
    state = confirmed(switched(installed(confirmed(switched(installed(RolloutState(), bundle(1)))), bundle(2))))
    state = rolled_back(state)
    assert (state.live, state.previous, state.stage) == (bundle(1), None, Stage.SETTLED)
    with pytest.raises(ValueError, match="no previous"):
        rolled_back(state)


def test_a_newer_release_takes_the_place_of_one_in_the_shadow():
    state = installed(installed(RolloutState(), bundle(1)), bundle(2))
    assert state.candidate == bundle(2)
    assert state.needed_ids == {bundle(2).bundle_id}


def test_a_release_of_the_live_bundle_changes_its_number_alone():
    live = confirmed(switched(installed(RolloutState(), bundle(1))))
    again = bundle(2, bundle_id=bundle(1).bundle_id)
    state = installed(live, again)
    assert (state.live, state.candidate, state.stage, state.newest_sequence_number) == (again, None, Stage.SETTLED, 2)


def test_a_release_of_the_live_bundle_ends_the_shadow_of_another():
    state = installed(confirmed(switched(installed(RolloutState(), bundle(1)))), bundle(2))
    state = installed(state, bundle(3, bundle_id=bundle(1).bundle_id))
    assert (state.candidate, state.stage) == (None, Stage.SETTLED)


def test_what_is_no_news_is_never_installed():
    with pytest.raises(ValueError, match="not newer"):
        installed(RolloutState(newest_sequence_number=5), bundle(5))


@pytest.mark.parametrize("step", [switched, confirmed, rejected, rolled_back])
def test_a_step_that_cannot_be_taken_is_refused(step):
    with pytest.raises(ValueError, match=r"nothing|no previous"):
        step(RolloutState())


@pytest.mark.parametrize(
    "contradiction",
    [
        {"candidate": bundle(1), "newest_sequence_number": 1},
        {"stage": Stage.SHADOW},
        {"stage": Stage.PROBATION},
        {"live": bundle(2), "newest_sequence_number": 1},
    ],
)
def test_a_state_that_contradicts_itself_cannot_be(contradiction):
    with pytest.raises(ValueError, match=r"candidate|probation|newer"):
        RolloutState(**contradiction)


@given(st.lists(st.sampled_from(["install", "same", "switch", "confirm", "reject", "back"]), max_size=40))
def test_whatever_is_done_the_unit_has_a_live_bundle_and_numbers_never_fall(steps):
    state = RolloutState()
    for step in steps:
        before = state
        try:
            if step == "install":
                state = installed(state, bundle(state.newest_sequence_number + 1))
            elif step == "same":
                state = installed(state, bundle(state.newest_sequence_number + 1, bundle_id=state.live.bundle_id))
            else:
                state = {"switch": switched, "confirm": confirmed, "reject": rejected, "back": rolled_back}[step](state)
        except ValueError:
            assert state == before
        assert state.newest_sequence_number >= before.newest_sequence_number
        assert state.live.from_factory or state.live.bundle_id in state.needed_ids
        assert len(state.needed_ids) <= 3
