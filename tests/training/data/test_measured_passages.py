from __future__ import annotations

import inspect
import re
from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.features import GRIP_TABLE, PAPER_TABLE, road_features
from roadgrip.passage_export import ExportedPassage, ExportHead
from roadgrip.reasons import Reason
from roadgrip.records import QualityFlag
from roadgrip.section_file import section_to_json
from rsu_app.domain import plausibility
from tests.rsu_app.fakes import NOON_UNIX_S, make_section
from tests.training.data.exports import BEND, exported, head_of
from training.data.exported_passages import Export, PassageReason, RefusedPassage
from training.data.ground_truth import Measurement
from training.data.measured_passages import Joined, label_of, measured_runs
from training.dataset import LABEL_COLUMNS

HOUR = Measurement("bend", NOON_UNIX_S - 1800.0, NOON_UNIX_S + 1800.0, 0.4, 0.02, "ViaFriction 3")


def export_of(*passages: ExportedPassage, name: str = "a.jsonl", head: ExportHead | None = None) -> Export:
    numbered = dict(enumerate(passages, start=2))
    return Export(name, "0" * 16, head or head_of(BEND), numbered, ())


def joined_one(
    passage: ExportedPassage, *measurements: Measurement, head: ExportHead | None = None, **options
) -> Joined:
    return measured_runs([export_of(passage, head=head)], measurements or [HOUR], **options)


def only_reason(found: Joined) -> PassageReason:
    assert found.rows_count == 0
    (refused,) = found.refused
    assert refused.line_number == 2
    assert refused.message
    return refused.reason


def test_a_passage_gets_the_friction_that_was_measured_meanwhile():
    passage = exported()
    found = joined_one(passage)
    runs = found.runs_by_table[GRIP_TABLE.digest]
    assert found.refused == ()
    assert runs.usable.tolist() == [True]
    assert runs.labels["label_mu"].tolist() == [pytest.approx(0.36)]
    assert runs.labels["base_friction_mu"].tolist() == [0.4]
    assert runs.section_id == ("bend",)
    assert runs.scenario == ("bend@20260101T1130Z",)


def test_features_are_what_the_vehicle_told_and_what_the_unit_computes_from_its_map():
    passage = exported()
    row = joined_one(passage).runs_by_table[GRIP_TABLE.digest].features[0]
    told_count = len(GRIP_TABLE.kinematic)
    assert row[:told_count].astype(np.float32).tolist() == passage.values.tolist()
    assert row[told_count:].tolist() == road_features(BEND, GRIP_TABLE).tolist()


def test_what_nobody_knows_of_a_passage_is_no_number():
    passage = exported()
    labels = joined_one(passage).runs_by_table[GRIP_TABLE.digest].labels
    assert set(labels) == set(LABEL_COLUMNS)
    known = {name for name in LABEL_COLUMNS if np.isfinite(labels[name][0])}
    assert known == {"label_mu", "base_friction_mu", "rated_speed_mps", "mean_speed_mps", "duration_s"}
    assert labels["rated_speed_mps"][0] == BEND.speed_limit_mps
    assert labels["duration_s"][0] == passage.duration_s
    assert labels["mean_speed_mps"][0] == passage.values[GRIP_TABLE.index("speed_mean_mps")]


def test_the_uncertainty_of_a_label_is_that_of_trailer_and_wear():
    label_mu, label_sd_mu = label_of(HOUR)
    assert label_mu == pytest.approx(0.36)
    assert label_sd_mu == pytest.approx(sqrt((0.9 * 0.02) ** 2 + 0.2**2 / 12.0 * (0.4**2 + 0.02**2)))
    assert joined_one(exported()).label_sd_mu[GRIP_TABLE.digest].tolist() == [label_sd_mu]


def test_the_uncertainty_of_a_label_is_what_drawn_trailers_and_tyres_give(rng):
    drawn = rng.normal(HOUR.mu, HOUR.mu_sd, 200_000) * rng.uniform(0.8, 1.0, 200_000)
    label_mu, label_sd_mu = label_of(HOUR)
    assert label_mu == pytest.approx(drawn.mean(), rel=2e-3)
    assert label_sd_mu == pytest.approx(drawn.std(), rel=5e-3)


def test_the_wear_ratio_is_what_the_label_is_scaled_by():
    labels = joined_one(exported(), wear_ratio=1.0).runs_by_table[GRIP_TABLE.digest].labels
    assert labels["label_mu"].tolist() == [0.4]


# Which measurement ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("after_s", "joins"),
    [
        (-2400.1, False),
        (-2400.0, True),
        (-1800.0, True),
        (1799.0, True),
        (1800.0, True),
        (2399.0, True),
        (2400.0, False),
    ],
)
def test_a_span_is_widened_by_the_slack_at_both_ends(after_s, joins):
    found = joined_one(exported(left_unix_s=NOON_UNIX_S + after_s))
    assert found.rows_count == int(joins)
    if not joins:
        assert only_reason(found) is PassageReason.NO_MEASUREMENT


def test_without_slack_a_span_is_what_it_is():
    at_the_end = exported(left_unix_s=NOON_UNIX_S + 1800.0)
    assert only_reason(joined_one(at_the_end, slack_s=0.0)) is PassageReason.NO_MEASUREMENT
    assert joined_one(exported(left_unix_s=NOON_UNIX_S - 1800.0), slack_s=0.0).rows_count == 1


def test_a_passage_within_a_span_does_not_look_at_its_neighbours():
    salted = replace(HOUR, from_unix_s=HOUR.until_unix_s, until_unix_s=HOUR.until_unix_s + 3600.0, mu=0.7)
    found = joined_one(exported(left_unix_s=HOUR.until_unix_s - 10.0), HOUR, salted)
    assert found.runs_by_table[GRIP_TABLE.digest].labels["base_friction_mu"].tolist() == [0.4]
    found = joined_one(exported(left_unix_s=HOUR.until_unix_s), HOUR, salted)
    assert found.runs_by_table[GRIP_TABLE.digest].labels["base_friction_mu"].tolist() == [0.7]


def test_a_passage_between_two_measurements_has_none():
    begin_unix_s = HOUR.until_unix_s + 900.0
    later = replace(HOUR, from_unix_s=begin_unix_s, until_unix_s=begin_unix_s + 3600.0, mu=0.7)
    between = exported(left_unix_s=HOUR.until_unix_s + 450.0)
    assert only_reason(joined_one(between, HOUR, later)) is PassageReason.SEVERAL_MEASUREMENTS


def test_a_passage_that_two_trailers_measured_has_none():
    second = replace(HOUR, mu=0.42, instrument="RCR")
    assert only_reason(joined_one(exported(), HOUR, second)) is PassageReason.SEVERAL_MEASUREMENTS


def test_a_measurement_speaks_for_its_own_section():
    elsewhere = replace(HOUR, section_id="elsewhere")
    assert only_reason(joined_one(exported(), elsewhere)) is PassageReason.NO_MEASUREMENT


# What is refused ------------------------------------------------------------------------------------------------------


def test_a_passage_without_its_map_is_refused():
    other = make_section("bend", radius_m=120.0)
    assert only_reason(joined_one(exported(), head=head_of(other))) is PassageReason.NO_MAP


def test_the_map_of_a_passage_may_come_from_another_export_or_from_elsewhere():
    surveyed = make_section("bend", radius_m=120.0)
    newer, older = export_of(exported(), head=head_of(surveyed)), export_of(name="b.jsonl")
    assert measured_runs([newer, older], [HOUR]).rows_count == 1
    assert measured_runs([newer], [HOUR], sections=[BEND]).rows_count == 1
    assert measured_runs([newer], [HOUR], sections=[surveyed]).rows_count == 0


def test_a_map_that_one_export_holds_damaged_is_taken_from_the_other():
    damaged = export_of(exported(), head=head_of(sections_json={BEND.version: "{}"}))
    assert measured_runs([damaged, export_of(name="b.jsonl")], [HOUR]).rows_count == 1


@pytest.mark.parametrize("text", ["{}", section_to_json(make_section("bend", radius_m=120.0))])
def test_a_map_that_is_none_or_another_one_is_refused(text):
    head = head_of(sections_json={BEND.version: text})
    assert only_reason(joined_one(exported(), head=head)) is PassageReason.NO_MAP


def test_a_map_of_another_section_is_refused():
    passage = exported(section_id="other")
    measurement = replace(HOUR, section_id="other")
    assert only_reason(joined_one(passage, measurement)) is PassageReason.NO_MAP


def changed_value(name: str, value: float) -> ExportedPassage:
    passage = exported()
    values = passage.values.copy()
    values[GRIP_TABLE.index(name)] = value
    return replace(passage, values=values)


@pytest.mark.parametrize(
    ("passage", "reason"),
    [
        (exported(table_digest="0123456789abcdef"), PassageReason.WRONG_FEATURE_TABLE),
        (exported(values=np.zeros(3, dtype=np.float32)), PassageReason.MALFORMED),
        (changed_value("speed_mean_mps", np.nan), PassageReason.NOT_FINITE),
        (exported(duration_s=np.nan), PassageReason.NOT_FINITE),
        (changed_value("speed_max_mps", 200.0), PassageReason.OUT_OF_RANGE),
        (changed_value("speed_q20_mps", 40.0), PassageReason.OUT_OF_RANGE),
        (exported(duration_s=1.0), PassageReason.IMPOSSIBLE_DURATION),
        (exported(quality=int(QualityFlag.SENSORS_DOUBTFUL)), PassageReason.QUALITY),
        (exported(quality=int(QualityFlag.REFERENCE_SPEED | QualityFlag.NO_GNSS)), PassageReason.QUALITY),
        (exported(left_unix_s=np.nan), PassageReason.NO_MEASUREMENT),
    ],
)
def test_what_cannot_be_learned_from_is_refused_with_its_reason(passage, reason):
    assert only_reason(joined_one(passage)) is reason


@pytest.mark.parametrize("quality", [QualityFlag.NO_GNSS, QualityFlag.STABILITY_ACTIVE, QualityFlag.SAMPLES_MISSING])
def test_ordinary_flaws_are_learned_from_as_the_model_is_asked_about_them(quality):
    assert joined_one(exported(quality=int(quality))).rows_count == 1


def test_what_the_model_could_not_judge_is_learned_from():
    assert joined_one(exported(flags=1, mu=None)).rows_count == 1


def test_every_refusal_of_a_unit_that_can_come_up_here_has_its_reason():
    asked = {Reason[name].value for name in re.findall(r"Reason\.([A-Z_]+)", inspect.getsource(plausibility))}
    assert "out_of_range" in asked
    # Ages and ids are not exported; what stands for them here is always right.
    assert asked - {Reason.IMPOSSIBLE_AGE.value} <= {reason.value for reason in PassageReason}


def test_a_passage_in_two_exports_is_one_row():
    first, second = export_of(exported(0), exported(1)), export_of(exported(1), exported(2), name="b.jsonl")
    found = measured_runs([first, second], [HOUR])
    assert found.rows_count == 3
    assert [(each.export, each.line_number, each.reason) for each in found.refused] == [
        ("b.jsonl", 2, PassageReason.REPEATED)
    ]


def test_lines_that_held_no_passage_stay_in_the_report():
    broken = RefusedPassage("a.jsonl", 7, PassageReason.MALFORMED, "no JSON")
    found = measured_runs([replace(export_of(exported(0)), refused=(broken,))], [HOUR])
    assert found.refused == (broken,)


def test_refusals_are_counted_by_reason():
    passages = [exported(0), exported(1, quality=64), exported(2, left_unix_s=0.0), exported(3, left_unix_s=0.0)]
    found = measured_runs([export_of(*passages)], [HOUR])
    assert found.rows_count == 1
    assert found.refused_count == {PassageReason.NO_MEASUREMENT: 2, PassageReason.QUALITY: 1}
    assert list(found.refused_count) == [PassageReason.NO_MEASUREMENT, PassageReason.QUALITY]


@pytest.mark.parametrize("options", [{"slack_s": -1.0}, {"slack_s": np.nan}, {"wear_ratio": 0.0}, {"wear_ratio": 1.6}])
def test_options_that_are_none_are_refused(options):
    with pytest.raises(ValueError, match="is none"):
        joined_one(exported(), **options)


# Tables and names -----------------------------------------------------------------------------------------------------


def test_rows_of_different_tables_stay_apart():
    found = measured_runs([export_of(exported(0), exported(1, table=PAPER_TABLE), exported(2))], [HOUR])
    counts = {digest: len(runs) for digest, runs in found.runs_by_table.items()}
    assert counts == {GRIP_TABLE.digest: 2, PAPER_TABLE.digest: 1}
    assert {digest: len(sd) for digest, sd in found.label_sd_mu.items()} == counts
    assert found.runs_by_table[PAPER_TABLE.digest].table == PAPER_TABLE


def test_newer_rows_can_be_cut_to_an_older_table():
    again = replace(HOUR, section_id="other", mu=0.6)
    other = make_section("other", radius_m=-80.0)
    passages = [exported(0), exported(1, table=PAPER_TABLE), exported(2, section=other)]
    head = head_of(BEND, other)
    found = measured_runs([export_of(*passages, head=head)], [HOUR, again], table=PAPER_TABLE)
    assert list(found.runs_by_table) == [PAPER_TABLE.digest]
    runs, sd = found.runs_by_table[PAPER_TABLE.digest], found.label_sd_mu[PAPER_TABLE.digest]
    assert (len(runs), runs.table) == (3, PAPER_TABLE)
    speeds = {float(each.values[PAPER_TABLE.index("speed_mean_mps")]) for each in passages}
    assert set(runs.columns(["speed_mean_mps"])[:, 0].tolist()) == speeds
    expected = {section: label_of(each)[1] for section, each in (("bend", HOUR), ("other", again))}
    assert sd.tolist() == [expected[section] for section in runs.section_id]


def test_older_rows_cannot_be_made_newer():
    found = joined_one(exported(table=PAPER_TABLE), table=GRIP_TABLE)
    assert only_reason(found) is PassageReason.OLDER_TABLE


@given(st.permutations(range(6)), st.integers(-1500, 1500))
def test_keys_tell_neither_the_order_nor_the_time_of_passages(order, after_s):
    passages = [exported(seed) for seed in range(6)]
    moved = [replace(passages[i], left_unix_s=NOON_UNIX_S + after_s) for i in order]
    first, second = (
        measured_runs([export_of(*each)], [HOUR]).runs_by_table[GRIP_TABLE.digest] for each in (passages, moved)
    )
    assert first.run_key == second.run_key == tuple(sorted(set(first.run_key)))
    assert first.digest() == second.digest()
