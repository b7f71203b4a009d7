"""The verdict as a record: it comes back from JSON, and cannot be bent without breaking."""

import hashlib
import json
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.training.gate.bouts import thresholds
from training.gate.verdict import (
    Check,
    HeldOut,
    Verdict,
    VerdictError,
    check_of,
    in_order,
    verdict_digest,
    verdict_from_json,
    verdict_to_json,
)
from training.study.picture import Axis, Bars


def verdict(*checks: Check) -> Verdict:
    return Verdict(
        challenger="aaaa",
        champion=None,
        checks=checks or (check("error"), check("drift", passed=False, required=False)),
        holdouts=(HeldOut("known_roads", "0123456789abcdef", 12, 10),),
        thresholds=thresholds(),
        pictures=(Bars("title", "names", Axis("heights"), ("a", "b"), (("group", (1.0, 2.5)),)),),
        made_unix_s=1_790_000_000.25,
        software_version="1.2.3",
    )


def check(name, *, passed=True, required=True):
    return check_of(
        name, "bundle", passed=passed, required=required, sentence="said", figures={"a_ratio": 0.1}, limits={}
    )


def test_a_verdict_comes_back_from_its_json():
    assert verdict_from_json(verdict_to_json(verdict())) == verdict()


def test_the_digest_is_that_of_the_text():
    text = verdict_to_json(verdict())
    assert verdict_digest(verdict()) == hashlib.sha256(text.encode()).hexdigest()
    assert verdict_digest(replace(verdict(), champion="bbbb")) != verdict_digest(verdict())


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=6))
def test_it_passes_exactly_when_something_was_required_and_nothing_required_failed(asked):
    said = replace(verdict(), checks=tuple(check("any", passed=p, required=r) for p, r in asked))
    assert said.passed == (any(r for _, r in asked) and all(p for p, r in asked if r))
    assert said.passed == (not said.failures and any(r for _, r in asked))


def bent(**changes):
    return json.dumps({**json.loads(verdict_to_json(verdict())), **changes})


def bent_check(**changes):
    raw = json.loads(verdict_to_json(verdict()))
    raw["checks"][0] |= changes
    return json.dumps(raw)


def laxer_thresholds():
    raw = json.loads(verdict_to_json(verdict()))["thresholds"]
    raw["parity"]["tolerance_mu"] = 1.0
    return raw


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (bent(passed=False), "its checks say True"),
        (bent_check(passed=False), "it says passed: True"),
        (bent(thresholds=laxer_thresholds()), "its thresholds are not those"),
        (bent(format_version=2), "verdict format 2"),
        (bent_check(spare=1), "a Check has"),
        (bent_check(passed=1), "neither true nor false"),
        (bent_check(figures={"a_ratio": "0.1"}), "no finite number"),
        (bent(made_unix_s=float("nan")), "no finite number"),
        (bent(checks=[{}]), "a Check has"),
        (bent(challenger=None), "no text"),
        ("[]", "no verdict"),
        ("{", "no verdict"),
    ],
)
def test_what_is_no_verdict_or_contradicts_itself_is_refused(text, said):
    with pytest.raises(VerdictError, match=said):
        verdict_from_json(text)


def test_figures_that_are_no_numbers_are_left_out():
    made = check_of(
        "any",
        "bundle",
        passed=True,
        sentence="said",
        figures={"a_ratio": float("nan"), "b_ratio": 1, "c": float("inf")},
    )
    assert made.figures == {"b_ratio": 1.0}


def test_failures_come_first_and_what_only_informs_of_something_wrong_next():
    checks = [check("fine"), check("told", required=False), check("odd", passed=False, required=False)]
    checks.append(check("bad", passed=False))
    assert [each.name for each in in_order(checks)] == ["bad", "odd", "fine", "told"]
