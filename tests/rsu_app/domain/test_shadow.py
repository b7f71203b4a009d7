from __future__ import annotations

from dataclasses import replace

import pytest

from roadgrip.records import NotCounted
from rsu_app.domain.judgement import Judgement
from rsu_app.domain.shadow import KEPT_COUNT, Answer, ShadowPolicy, ShadowRecord, Verdict, told, verdict

POLICY = ShadowPolicy(shadow_count=50, probation_count=50, judged_from_count=10)


def said(mu: float | None = 0.5, *, took_s: float = 1e-4, flags: NotCounted = NotCounted.NONE, at_least: bool = False):
    return Answer(Judgement(mu, flags, at_least=at_least), took_s)


SILENCE = Answer(None, 0.0)


def compared(pairs) -> ShadowRecord:
    record = ShadowRecord()
    for newer, older in pairs:
        record.add(newer=newer, older=older)
    return record


def verdict_on(pairs, policy: ShadowPolicy = POLICY, *, wanted_count: int = 50):
    return verdict(compared(pairs).comparison(), policy, wanted_count=wanted_count)


def test_two_that_agree_go_on_until_enough_passages_were_compared():
    assert verdict_on([(said(), said())] * 49)[0] is Verdict.GO_ON
    assert verdict_on([(said(), said())] * 50)[0] is Verdict.PASSED


def test_nothing_needs_to_be_compared_where_nothing_is_asked_for():
    assert verdict_on([], wanted_count=0)[0] is Verdict.PASSED


def test_a_single_passage_without_an_answer_fails():
    found, why = verdict_on([(SILENCE, said())])
    assert found is Verdict.FAILED
    assert "without an answer" in why


def test_silence_of_the_older_says_nothing_about_the_newer():
    record = compared([(said(), SILENCE)] * 60)
    assert record.comparison().passages_count == 0


@pytest.mark.parametrize("factor", [0.85, 1.15])
def test_a_median_beyond_its_limit_fails_in_either_direction_before_the_shadow_ends(factor):
    pairs = [(said(0.5 * factor), said(0.5))] * 10
    assert verdict_on(pairs[:9])[0] is Verdict.GO_ON
    found, why = verdict_on(pairs)
    assert found is Verdict.FAILED
    assert "in the median" in why


def test_a_few_passages_far_apart_are_within_the_limits_and_many_are_not():
    apart, alike = (said(0.9), said(0.5)), (said(0.5), said(0.5))
    assert verdict_on([alike] * 47 + [apart] * 3)[0] is Verdict.PASSED
    found, why = verdict_on([alike] * 40 + [apart] * 10)
    assert found is Verdict.FAILED
    assert "one passage in ten" in why


def test_one_that_takes_too_long_fails():
    found, why = verdict_on([(said(took_s=0.05), said())] * 10)
    assert found is Verdict.FAILED
    assert "50.0 ms" in why


def test_one_slow_answer_among_many_does_not_fail():
    assert verdict_on([(said(), said())] * 49 + [(said(took_s=1.0), said())])[0] is Verdict.PASSED


def test_one_that_names_no_friction_any_more_fails():
    found, why = verdict_on([(said(at_least=True), said())] * 10)
    assert found is Verdict.FAILED
    assert "names a friction in -100%" in why


def test_one_that_calls_everything_strange_fails():
    assert verdict_on([(said(flags=NotCounted.OUT_OF_ENVELOPE), said())] * 10)[0] is Verdict.FAILED


def test_only_passages_for_which_both_name_a_friction_are_told_apart():
    record = compared([(said(0.9, at_least=True), said(0.3)), (said(0.5), said(None)), (said(0.55), said(0.5))])
    found = record.comparison()
    assert found.both_named_count == 1
    assert found.median_ratio == pytest.approx(0.0953, abs=1e-4)


def test_turning_both_round_turns_the_sign_of_the_median():
    pairs = [(said(0.5), said(0.4)), (said(0.3), said(0.31)), (said(0.7), said(0.5))]
    there, back = compared(pairs).comparison(), compared([(b, a) for a, b in pairs]).comparison()
    assert there.median_ratio == pytest.approx(-(back.median_ratio or 0.0))
    assert there.spread_ratio == pytest.approx(back.spread_ratio)


def test_what_is_remembered_is_bounded_and_the_count_goes_on():
    record = compared([(said(), said())] * (KEPT_COUNT + 7))
    assert record.comparison().passages_count == KEPT_COUNT + 7
    assert record.comparison().both_named_count == KEPT_COUNT


def test_a_lenient_policy_lets_differences_pass():
    lenient = replace(POLICY, median_limit_ratio=1.0, spread_limit_ratio=1.0)
    assert verdict_on([(said(0.8), said(0.5))] * 50, lenient)[0] is Verdict.PASSED


def test_a_comparison_without_a_named_friction_says_so():
    assert "no passage" in told(ShadowRecord().comparison())
