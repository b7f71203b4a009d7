"""More slip at equal demand: what is scaled, what stays, and who is found out."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.features import GRIP_TABLE, PAPER_TABLE, PROFILE_FRICTIONS_MU
from tests.training.gate.bouts import GOOD, GOOD_OF_PAPER, WRONG_SIGN, contender, drives, thresholds
from training.gate.monotone import monotone_sanity, moves_of, with_less_found, with_more_slip

LIMITS = thresholds().monotone


@pytest.fixture(scope="module")
def runs():
    return drives("unseen_roads", roads_count=2)


def asked(bundle, runs, **changes):
    rng = np.random.default_rng(1)
    found = monotone_sanity(bundle, {"unseen roads": runs}, replace(LIMITS, **changes), rng=rng)
    return {check.subject.split(", ")[1]: check for check in found.checks}


def test_a_model_that_goes_by_the_inverse_passes_both_ways(tmp_path, runs):
    checks = asked(contender(tmp_path / "a"), runs)
    assert {name: check.passed for name, check in checks.items()} == {"slip alone": True, "slip and inverse": True}
    assert checks["slip alone"].figures["mean_rise_ratio"] == 0.0
    assert checks["slip and inverse"].figures["mean_rise_ratio"] == pytest.approx(-np.log(1.1), abs=1e-5)


def test_a_model_with_the_sign_of_sideslip_reversed_fails(tmp_path, runs):
    checks = asked(contender(tmp_path / "a", weights=WRONG_SIGN), runs)
    assert checks["slip alone"].failed
    assert not checks["slip and inverse"].failed  # the inverse falls by more than the slip raises


def test_a_model_that_reads_the_inverse_backwards_fails(tmp_path, runs):
    checks = asked(contender(tmp_path / "a", weights={"grip_all_best_mu": -0.5}, bias_mu=0.7), runs)
    assert not checks["slip alone"].failed
    assert checks["slip and inverse"].failed


def test_a_few_drives_that_rise_steeply_fail_although_the_mean_falls(tmp_path, runs):
    features = runs.features.copy()
    place = GRIP_TABLE.index("sideslip_max_rad")
    features[:, place] = np.where(np.arange(len(runs)) % 5 == 0, 0.2, -0.2)
    checks = asked(
        contender(tmp_path / "a", weights={**GOOD, "sideslip_max_rad": 1.0}), replace(runs, features=features)
    )
    assert checks["slip alone"].figures["mean_rise_ratio"] < LIMITS.mean_rise_ratio
    assert checks["slip alone"].figures["steep_frac"] == pytest.approx(0.2, abs=0.01)
    assert checks["slip alone"].failed


def test_the_papers_table_has_no_inverse_to_move(tmp_path, runs):
    assert list(moves_of(PAPER_TABLE)) == ["slip alone"]
    told = runs.for_table(PAPER_TABLE)
    assert list(asked(contender(tmp_path / "a", of_paper=GOOD_OF_PAPER), told)) == ["slip alone"]


def test_demand_road_and_shapes_stay_when_slip_is_scaled(runs):
    rows = np.clip(runs.features + 0.01, GRIP_TABLE.minimum, GRIP_TABLE.maximum)
    moved = with_more_slip(rows, GRIP_TABLE, 2.0)
    changed = {GRIP_TABLE.names[i] for i in np.flatnonzero((moved != rows).any(axis=0))}
    assert changed == {
        f"{signal}_{statistic}_{unit}"
        for signal, unit in (("sideslip", "rad"), ("sideslip_rate", "radps"), ("yaw_rate_excess", "radps"))
        for statistic in ("mean", "std", "q20", "q40", "q60", "q80", "min", "median", "max")
    }


@given(st.floats(1.01, 3.0))
def test_the_likelihoods_move_down_by_the_factor(factor):
    row = np.clip(np.zeros((1, len(GRIP_TABLE))), GRIP_TABLE.minimum, GRIP_TABLE.maximum)
    profile = GRIP_TABLE.columns([f"grip_profile_{100 * mu:.0f}_ratio" for mu in PROFILE_FRICTIONS_MU])
    log_mu = np.log(PROFILE_FRICTIONS_MU)
    row[0, profile] = -np.abs(log_mu - np.log(0.5))
    row[0, GRIP_TABLE.index("grip_all_best_mu")] = 0.5
    row[0, GRIP_TABLE.index("demand_q95_use_ratio")] = 0.4
    moved = with_less_found(row, GRIP_TABLE, factor)[0]
    assert moved[GRIP_TABLE.index("grip_all_best_mu")] == pytest.approx(0.5 / factor)
    assert moved[GRIP_TABLE.index("demand_q95_use_ratio")] == pytest.approx(0.4 * factor)
    # Where the grid reaches, the profile is that of a friction smaller by the factor, up to interpolation.
    inside = log_mu + np.log(factor) <= log_mu[-1]
    expected = -np.abs(log_mu - np.log(0.5 / factor))
    assert moved[profile][inside] == pytest.approx(expected[inside], abs=0.2)


def test_only_some_rows_are_asked_where_there_are_many(tmp_path, runs):
    bundle = contender(tmp_path / "a", weights=WRONG_SIGN)
    few, every = (asked(bundle, runs, most_rows_count=count)["slip alone"].figures for count in (5, 10_000))
    assert few["mean_rise_ratio"] != every["mean_rise_ratio"]
