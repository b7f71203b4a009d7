from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.bundle import Envelope
from roadgrip.features import NEWEST_TABLE, PAPER_TABLE
from roadgrip.reasons import Reason
from roadgrip.records import NotCounted
from rsu_app.domain.plausibility import age_flag, envelope_flag, estimate_flag, implausibility
from tests.bundles import make_model, make_ordinary
from tests.rsu_app.fakes import make_passage, make_section

SECTION = make_section()
NAMES = [f.name for f in NEWEST_TABLE.kinematic]


def with_value(name, value):
    values = list(make_passage(SECTION).summary.values)
    values[NAMES.index(name)] = value
    return make_passage(SECTION, values=tuple(values))


def reason_of(passage):
    refusal = implausibility(passage, SECTION)
    return None if refusal is None else refusal.reason


@given(st.integers(0, 2**32 - 1), st.floats(0.2, 0.9), st.floats(0.0, 86_400.0))
def test_whatever_can_have_happened_is_let_through(seed, mu, age_s):
    assert reason_of(make_passage(SECTION, seed=seed, mu=mu, age_s=age_s)) is None


def test_a_constant_signal_is_let_through():
    values = list(make_passage(SECTION).summary.values)
    values[0:11] = [0.1, 0.0, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.0, 0.0]
    assert reason_of(make_passage(SECTION, values=tuple(values))) is None


def test_the_range_is_compared_as_the_number_that_arrives():
    values = list(make_passage(SECTION).summary.values)
    limit = float(np.float32(1.6))
    values[11:22] = [limit, 0.0, *[limit] * 7, 0.0, 0.0]
    assert limit > 1.6
    assert reason_of(make_passage(SECTION, values=tuple(values))) is None


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf"), 1e300])
@pytest.mark.parametrize("name", [NAMES[0], NAMES[30], NAMES[-1]])
def test_a_value_that_is_no_number_is_refused(name, value):
    assert reason_of(with_value(name, value)) is Reason.NOT_FINITE


@pytest.mark.parametrize(
    "passage", [make_passage(SECTION, age_s=float("nan")), make_passage(SECTION, duration_s=float("nan"))]
)
def test_a_time_that_is_no_number_is_refused(passage):
    assert reason_of(passage) is Reason.NOT_FINITE


@pytest.mark.parametrize("feature", NEWEST_TABLE.kinematic, ids=lambda f: f.name)
def test_a_value_beyond_what_can_be_true_is_refused_by_name(feature):
    beyond = feature.maximum + 0.01 * (feature.maximum - feature.minimum)
    refusal = implausibility(with_value(feature.name, beyond), SECTION)
    assert refusal is not None
    assert refusal.reason is Reason.OUT_OF_RANGE
    assert feature.name in refusal.detail


@pytest.mark.parametrize(
    ("name", "value", "law"),
    [
        ("steer_q40_rad", 0.9, "ascend"),
        ("steer_min_rad", 0.5, "ascend"),
        ("speed_mean_mps", 70.0, "mean lies"),
        ("steer_std_rad", 0.9, "half the range"),
        ("sideslip_std_rad", 0.0, "one deviation"),
        ("yaw_rate_excess_skewness", 30.0, "contradict"),
    ],
)
def test_statistics_that_cannot_be_true_together_are_refused(name, value, law):
    refusal = implausibility(with_value(name, value), SECTION)
    assert refusal is not None
    assert refusal.reason is Reason.OUT_OF_RANGE
    assert law in refusal.detail


@pytest.mark.parametrize(("share", "possible"), [(0.49, True), (0.51, False)])
def test_a_deviation_is_at_most_half_the_range(share, possible):
    values = list(make_passage(SECTION).summary.values)
    low, high = values[NAMES.index("speed_min_mps")], values[NAMES.index("speed_max_mps")]
    values[NAMES.index("speed_std_mps")] = share * (high - low)
    assert (reason_of(make_passage(SECTION, values=tuple(values))) is None) is possible


def test_statistics_shifted_by_one_place_are_refused():
    values = make_passage(SECTION).summary.values
    assert reason_of(make_passage(SECTION, values=(values[-1], *values[:-1]))) is Reason.OUT_OF_RANGE


@pytest.mark.parametrize("factor", [0.0, -1.0, 0.5, 0.75, 1.3, 100.0])
def test_a_duration_that_does_not_fit_speed_and_length_is_refused(factor):
    duration_s = factor * make_passage(SECTION).summary.duration_s
    assert reason_of(make_passage(SECTION, duration_s=duration_s)) is Reason.IMPOSSIBLE_DURATION


@pytest.mark.parametrize("age_s", [-0.001, -1e9, 86_401.0])
def test_an_impossible_age_is_refused(age_s):
    assert reason_of(make_passage(SECTION, age_s=age_s)) is Reason.IMPOSSIBLE_AGE


def test_another_map_is_refused_with_both_versions():
    refusal = implausibility(make_passage(SECTION, map_version="0" * 16), SECTION)
    assert refusal is not None
    assert refusal.reason is Reason.STALE_MAP
    assert "0" * 16 in refusal.detail
    assert SECTION.version in refusal.detail


def test_another_feature_table_is_refused_before_its_values_are_looked_at():
    passage = make_passage(SECTION, table_digest="f" * 16, values=(float("nan"),))
    assert reason_of(passage) is Reason.WRONG_FEATURE_TABLE


def test_a_table_that_is_known_is_refused_where_it_is_not_served(wider_table):
    passage = make_passage(SECTION, table=wider_table)
    assert reason_of(passage) is None
    refusal = implausibility(passage, SECTION, table_digests=(PAPER_TABLE.digest,))
    assert refusal is not None
    assert refusal.reason is Reason.WRONG_FEATURE_TABLE
    assert wider_table.digest in refusal.detail
    assert PAPER_TABLE.digest in refusal.detail


def test_a_summary_of_one_table_under_the_digest_of_another_is_refused(wider_table):
    wide, narrow = (make_passage(SECTION, table=table).summary.values for table in (wider_table, PAPER_TABLE))
    assert reason_of(make_passage(SECTION, values=wide, table_digest=PAPER_TABLE.digest)) is Reason.MALFORMED
    assert reason_of(make_passage(SECTION, values=narrow, table_digest=wider_table.digest)) is Reason.MALFORMED


def test_features_beside_the_statistics_know_their_range_and_no_other_law(wider_table):
    values = list(make_passage(SECTION, table=wider_table).summary.values)
    first = wider_table.index("made_up_00_ratio")
    values[first : first + 11] = np.linspace(50.0, -50.0, 11)  # as statistics of a signal they would break every law
    assert reason_of(make_passage(SECTION, table=wider_table, values=tuple(values))) is None
    values[first] = 50.1
    assert reason_of(make_passage(SECTION, table=wider_table, values=tuple(values))) is Reason.OUT_OF_RANGE


@pytest.mark.parametrize("changes", [{"values": (1.0,)}, {"passage_id": b"short"}])
def test_what_is_no_passage_is_malformed(changes):
    assert reason_of(make_passage(SECTION, **changes)) is Reason.MALFORMED


def test_a_passage_leaves_the_envelope_with_one_feature_more_than_allowed():
    width = len(NEWEST_TABLE)
    envelope = Envelope(lower=(0.0,) * width, upper=(1.0,) * width, outside_allowed_count=2)
    model = make_model(envelope=envelope)
    row = np.full(width, 0.5)
    row[:2] = (-1.0, 2.0)
    assert envelope_flag(row, model) == NotCounted.NONE
    row[5] = 1.5
    assert envelope_flag(row, model) == NotCounted.OUT_OF_ENVELOPE


def test_what_ordinary_drives_look_like_takes_the_place_of_the_box():
    """Speed and steering hang together; the box neither sees that nor is asked."""
    nowhere = Envelope(lower=(9.0,) * len(NEWEST_TABLE), upper=(9.0,) * len(NEWEST_TABLE), outside_allowed_count=0)
    model = replace(make_model(envelope=nowhere), ordinary=make_ordinary())
    row = np.zeros(len(NEWEST_TABLE))
    speed, steer, length = map(NEWEST_TABLE.index, ("speed_mean_mps", "steer_mean_rad", "section_length_m"))
    row[[speed, steer, length]] = (18.0, 0.08, 300.0)
    assert envelope_flag(row, model) == NotCounted.NONE
    row[steer] = -0.08
    assert envelope_flag(row, model) == NotCounted.OUT_OF_ENVELOPE
    row[[steer, length]] = (0.08, 700.0)
    assert envelope_flag(row, model) == NotCounted.OUT_OF_ENVELOPE


@pytest.mark.parametrize(
    ("mu", "flag"),
    [
        (0.5, NotCounted.NONE),
        (1.08, NotCounted.NONE),
        (1.2, NotCounted.ESTIMATE_OUT_OF_RANGE),
        (0.005, NotCounted.ESTIMATE_OUT_OF_RANGE),
        (-0.1, NotCounted.ESTIMATE_OUT_OF_RANGE),
        (float("nan"), NotCounted.ESTIMATE_OUT_OF_RANGE),
        (float("inf"), NotCounted.ESTIMATE_OUT_OF_RANGE),
    ],
)
def test_an_estimate_must_be_near_the_friction_the_model_was_trained_with(mu, flag):
    assert estimate_flag(mu, make_model(mu_range=(0.1, 1.0))) == flag


def test_an_age_beyond_the_window_is_flagged():
    assert age_flag(3600.0, window_s=3600.0) == NotCounted.NONE
    assert age_flag(3600.1, window_s=3600.0) == NotCounted.OLDER_THAN_WINDOW
