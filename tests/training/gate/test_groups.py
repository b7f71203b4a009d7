"""The group that fares worst: named, and held against the champion's."""

from dataclasses import replace

import numpy as np
import pytest

from tests.training.gate.bouts import case, contender, drives, thresholds
from training.designs import EXACT_SUFFIX
from training.gate.groups import errors_by_group, groups_of, worst_group

LIMITS = replace(thresholds().groups, fewest_rows_count=50)


def asked(judged, **changes):
    (check,) = worst_group(judged, replace(LIMITS, **changes), slack_ratio=1.0, required=True).checks
    return check


def spoiled(judged, *, rows):
    """The same with estimates of some drives a fifth too high."""
    mu = np.where(rows, 1.2 * judged.challenger.mu, judged.challenger.mu)
    return replace(judged, challenger=replace(judged.challenger, mu=mu))


@pytest.fixture
def judged(tmp_path):
    good = contender(tmp_path / "a")
    return case("unseen_roads", drives("unseen_roads"), good, good)


def test_the_champion_again_passes(judged):
    assert asked(judged).passed


def test_one_spoiled_road_of_twelve_fails_and_is_named(judged):
    check = asked(spoiled(judged, rows=np.array(judged.runs.section_id) == "unseen_roads-07"))
    assert not check.passed
    assert check.sentence.startswith("road unseen_roads-07 (60 drives)")
    assert check.figures["error_ratio"] > check.limits["error_ratio"]


def test_a_spoiled_band_of_friction_fails_and_is_named(judged):
    label_mu = judged.label_mu
    check = asked(spoiled(judged, rows=(label_mu >= 0.2) & (label_mu < 0.3)))
    assert not check.passed
    assert check.sentence.startswith("friction 0.2 to 0.3")


def test_groups_that_are_too_small_are_not_asked(judged):
    check = asked(spoiled(judged, rows=np.array(judged.runs.section_id) == "unseen_roads-07"), fewest_rows_count=61)
    assert "unseen_roads-07" not in check.sentence
    none = asked(judged, fewest_rows_count=10_000)
    assert not none.failed
    assert "no group" in none.sentence


def test_without_a_champion_groups_have_a_limit_of_their_own(judged):
    alone = replace(judged, champion=None)
    assert asked(alone).passed
    assert not asked(alone, alone_ratio=0.04).passed


def test_sensors_and_use_of_the_grip_make_groups_and_what_is_unknown_makes_none(judged):
    runs = judged.runs
    exact = tuple(f"{name}{EXACT_SUFFIX if i % 2 else ''}" for i, name in enumerate(runs.scenario))
    use = np.where(np.arange(len(runs)) < 100, np.nan, 0.5)
    told = replace(runs, scenario=exact, labels={**runs.labels, "peak_utilisation_ratio": use})
    assert set(groups_of(told)["sensors"].tolist()) == {"exact sensors", "other sensors"}
    names = [group.name for group in errors_by_group(replace(judged, runs=told), fewest_rows_count=50)]
    assert {"exact sensors", "use 0.4 to 0.6"} <= set(names)
    assert "use unknown" not in names


def test_every_drive_is_in_one_group_of_each_kind(judged):
    groups = errors_by_group(judged, fewest_rows_count=1)
    for kind in ("road", "friction", "use"):
        assert sum(group.rows_count for group in groups if group.name.startswith(kind)) == len(judged.runs)
