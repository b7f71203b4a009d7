"""What may be promoted, over every standing a bundle can have."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.ledger import Action
from roadgrip.release import DEFAULT_RINGS, ReleaseError
from training.gate.thresholds import default_thresholds
from training.gate.verdict import Verdict, check_of, verdict_digest, verdict_to_json
from training.laboratory import Laboratory
from training.promotion.decision import PromotionError, Standing, gate_of, promotion_problem, rings_of
from training.promotion.verdicts import verdicts_on

NEW, OLD = "a" * 16, "b" * 16
RINGS = ("canary", "valley", "all")

standings = st.builds(
    Standing,
    champion_id=st.sampled_from([None, NEW, OLD]),
    released_ids=st.frozensets(st.sampled_from([NEW, OLD])),
    been_in_rings=st.frozensets(st.sampled_from(RINGS)),
    verdict_passed=st.sampled_from([None, False, True]),
)


def problem(standing: Standing, ring: str, *, overridden: bool = False) -> str | None:
    return promotion_problem(NEW, ring, rings=RINGS, standing=standing, overridden=overridden)


@given(standings, st.sampled_from(RINGS))
def test_nothing_goes_out_without_a_passed_gate_but_the_first_bundle_of_all(standing, ring):
    if problem(standing, ring) is None:
        first_of_all = standing.champion_id is None and OLD not in standing.released_ids
        assert standing.verdict_passed or (standing.verdict_passed is None and first_of_all)
        assert gate_of(NEW, standing=standing, overridden=False) == ("passed" if standing.verdict_passed else "none")


@given(standings)
def test_no_ring_is_skipped_without_an_override(standing):
    assert ("valley" in standing.been_in_rings) or problem(standing, "all") is not None


@given(standings, st.sampled_from(RINGS))
def test_an_override_opens_every_ring_and_a_gate_that_was_not_passed_says_so(standing, ring):
    assert problem(standing, ring, overridden=True) is None
    gate = gate_of(NEW, standing=standing, overridden=True)
    assert gate is not None
    assert (gate == "passed") == (standing.verdict_passed is True)


@given(standings)
def test_what_was_passed_or_was_first_is_never_called_overridden(standing):
    without = gate_of(NEW, standing=standing, overridden=False)
    assert without is None or without == gate_of(NEW, standing=standing, overridden=True)


def test_a_ring_that_does_not_exist_cannot_be_overridden():
    standing = Standing(None, frozenset(), frozenset(), verdict_passed=True)
    assert "canary, valley, all" in str(problem(standing, "east", overridden=True))


def test_everything_that_is_missing_is_said_at_once():
    said = str(problem(Standing(OLD, frozenset([OLD]), frozenset(), verdict_passed=False), "valley"))
    assert "never in ring 'canary'" in said
    assert f"failed it against the champion {OLD}" in said
    assert "--override REASON" in said


def test_the_rings_are_the_laboratorys(tmp_path):
    lab = Laboratory(tmp_path)
    assert rings_of(lab) == DEFAULT_RINGS
    (tmp_path / "rings.json").write_text('["workshop", "valley", "all"]')
    assert rings_of(lab) == ("workshop", "valley", "all")


@pytest.mark.parametrize("text", ["", "{}", "[]", '["all", "all"]', '["All"]', '["canary", 2]'])
def test_what_is_no_list_of_rings_is_refused(tmp_path, text):
    (tmp_path / "rings.json").write_text(text)
    with pytest.raises(ReleaseError):
        rings_of(Laboratory(tmp_path))


# Verdicts ------------------------------------------------------------------------------------------------------------


def judged(lab: Laboratory, *, champion: str | None, passed: bool, made_unix_s: float) -> str:
    """Keep a verdict as the gate does, and return its digest."""
    verdict = Verdict(
        challenger=NEW,
        champion=champion,
        checks=(check_of("paired_error", "known_roads", passed=passed, sentence="As it is."),),
        holdouts=(),
        thresholds=default_thresholds(),
        pictures=(),
        made_unix_s=made_unix_s,
        software_version="0",
    )
    digest = verdict_digest(verdict)
    folder = lab.verdicts_folder / digest
    folder.mkdir(parents=True)
    (folder / "verdict.json").write_text(verdict_to_json(verdict), encoding="utf-8")
    lab.record(Action.JUDGED, NEW, reason="", evidence={"verdict": digest}, now_unix_s=made_unix_s)
    return digest


def test_the_newest_verdict_against_each_champion_counts(tmp_path):
    lab = Laboratory(tmp_path)
    judged(lab, champion=OLD, passed=True, made_unix_s=1.0)
    alone = judged(lab, champion=None, passed=True, made_unix_s=2.0)
    failed = judged(lab, champion=OLD, passed=False, made_unix_s=3.0)
    found = verdicts_on(lab, NEW)
    assert {champion: (verdict.digest, verdict.passed) for champion, verdict in found.items()} == {
        None: (alone, True),
        OLD: (failed, False),
    }
    assert verdicts_on(lab, OLD) == {}


def test_a_verdict_that_somebody_changed_is_refused(tmp_path):
    lab = Laboratory(tmp_path)
    digest = judged(lab, champion=None, passed=False, made_unix_s=1.0)
    path = lab.verdicts_folder / digest / "verdict.json"
    path.write_text(path.read_text().replace("false", "true"))
    with pytest.raises(PromotionError, match="not the verdict that the ledger names"):
        verdicts_on(lab, NEW)


def test_a_verdict_that_the_ledger_does_not_know_counts_for_nothing(tmp_path):
    lab = Laboratory(tmp_path)
    digest = judged(lab, champion=None, passed=True, made_unix_s=1.0)
    lab.ledger_path.write_text("")
    assert (lab.verdicts_folder / digest).is_dir()
    assert verdicts_on(lab, NEW) == {}
