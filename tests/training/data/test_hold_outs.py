from __future__ import annotations

from training.cli_designs import DEFAULT_SEED
from training.data.data_shelf import Role
from training.data.hold_outs import HOLD_OUT_SEED, hold_outs
from training.designs import PAPER_ROADS, random_roads
from training.manoeuvres import Manoeuvre
from training.scenarios import attempted, kept, run_of

SMALL = {each.role: each for each in hold_outs(seed=HOLD_OUT_SEED, runs_count=5, random_roads_count=3)}


def sections_of(role: Role) -> set[str]:
    return {scenario.section.section_id for scenario in SMALL[role].design.scenarios}


def test_each_simulated_hold_out_drives_what_its_role_says():
    assert set(SMALL) == {Role.KNOWN_ROADS, Role.UNSEEN_ROADS, Role.MANOEUVRES}
    assert sections_of(Role.KNOWN_ROADS) == set(PAPER_ROADS)
    assert sections_of(Role.MANOEUVRES) == set(Manoeuvre)
    assert len(sections_of(Role.UNSEEN_ROADS)) == 3
    assert all(scenario.extreme for scenario in SMALL[Role.MANOEUVRES].design.scenarios)


def test_the_size_is_what_was_asked_for():
    quotas = {role: {scenario.quota for scenario in each.design.scenarios} for role, each in SMALL.items()}
    assert quotas == {
        Role.KNOWN_ROADS: {kept(5)},
        Role.UNSEEN_ROADS: {attempted(2)},
        Role.MANOEUVRES: {kept(2)},
    }


def test_unseen_roads_are_not_those_of_the_designs_that_are_learned_from():
    learned = {
        scenario.section.nodes_m.tobytes()
        for seed in (DEFAULT_SEED, DEFAULT_SEED + 1)
        for scenario in random_roads(seed, 3, attempted(1))
    }
    unseen = {scenario.section.nodes_m.tobytes() for scenario in SMALL[Role.UNSEEN_ROADS].design.scenarios}
    assert unseen.isdisjoint(learned)


def test_runs_have_names_that_no_other_design_gives():
    for hold_out in SMALL.values():
        first = hold_out.design.scenarios[0]
        key = run_of(hold_out.design.terms, first, base_friction_mu=0.5, number=0).key
        assert key.startswith(f"holdout-{hold_out.role.replace('_', '-')}/")


def test_another_seed_is_another_hold_out():
    other = {each.role: each for each in hold_outs(seed=1, runs_count=5, random_roads_count=3)}
    assert all(other[role].design.identity != SMALL[role].design.identity for role in SMALL)
