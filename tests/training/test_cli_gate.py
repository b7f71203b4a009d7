"""The command `roadgrip-train gate`: what it prints, keeps and records, and how it ends."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from roadgrip.errors import ConfigurationError
from roadgrip.ledger import Action
from tests.training.gate.bouts import GOOD_OF_PAPER, contender, drives, holdouts, thresholds
from training.cli_gate import gate, resolve
from training.data.data_shelf import add_data_set
from training.dataset import write_runs
from training.gate.thresholds import ThresholdsError, thresholds_document
from training.gate.verdict import verdict_digest, verdict_from_json
from training.laboratory import Laboratory

app = typer.Typer()
app.command()(gate)


@pytest.fixture
def inside(tmp_path, monkeypatch):
    """A folder with a champion, a bad challenger, hold-outs and lax thresholds, and the current one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    contender(tmp_path / "champion", of_paper=GOOD_OF_PAPER)
    contender(tmp_path / "bad", weights={"grip_all_best_mu": 1.5}, of_paper=GOOD_OF_PAPER)
    for role, runs in holdouts().items():
        write_runs(runs, tmp_path / f"{role}.parquet", description={})
    asked = thresholds()
    # Machines differ: how fast they are is no matter of this test.
    asked = replace(asked, speed=replace(asked.speed, worse_ratio=1000.0, opening_median_s=60.0, opening_p99_s=60.0))
    (tmp_path / "thresholds.toml").write_text(toml_of(thresholds_document(asked)))
    return tmp_path


def toml_of(document):
    lines = []
    for place, table in document.items():
        lines.append(f"[{place}]")
        for name, value in table.items():
            text = json.dumps(value)
            if isinstance(value, dict):
                text = "{ " + ", ".join(f"{key} = {each}" for key, each in value.items()) + " }"
            lines.append(f"{name} = {text}")
    return "\n".join(lines)


def given():
    return [word for role in holdouts() for word in ("--holdout", f"{role}={role}.parquet")]


def invoke(*words):
    return CliRunner().invoke(app, ["--lab", "lab", "--thresholds", "thresholds.toml", *words])


def test_a_challenger_that_passes_leaves_a_verdict_a_page_and_a_line_in_the_ledger(inside):
    result = invoke("--challenger", "champion", "--champion", "champion", *given(), "--out", "told")
    assert result.exit_code == 0, result.output
    verdict = verdict_from_json((inside / "told" / "verdict.json").read_text())
    digest = verdict_digest(verdict)
    kept = inside / "lab" / "verdicts" / digest
    assert sorted(path.name for path in kept.iterdir()) == ["verdict.html", "verdict.json"]
    assert (kept / "verdict.json").read_text() == (inside / "told" / "verdict.json").read_text()
    (entry,) = Laboratory(inside / "lab").ledger()
    assert (entry.action, entry.subject) == (Action.JUDGED, verdict.challenger)
    assert entry.evidence == {"verdict": digest, "passed": "true"}


def test_one_that_does_not_is_told_why_first_and_ends_with_one(inside):
    result = invoke("--challenger", "bad", "--champion", "champion", *given())
    assert result.exit_code == 1, result.output
    rows = [line for line in result.stdout.splitlines() if "│" in line]
    assert "FAILED" in rows[0]
    assert "did not pass" in result.stdout
    (entry,) = Laboratory(inside / "lab").ledger()
    assert entry.evidence["passed"] == "false"
    assert "paired_error" in entry.reason


def test_machines_get_the_verdict_itself(inside):
    result = invoke("--challenger", "bad", *given(), "--json")
    assert result.exit_code == 1
    verdict = verdict_from_json(result.stdout)
    assert (verdict.champion, verdict.passed) == (None, False)


def test_hold_outs_come_from_the_shelf_of_the_laboratory(inside):
    lab = Laboratory(inside / "lab")
    put = partial(add_data_set, lab, origin="a test", licence="none", label_kind="made up")
    for role, runs in holdouts().items():
        put(runs, name=role.replace("_", "-"), kind="simulated", role=role)
    put(drives("known_roads", seed=9), name="teaching", kind="simulated", role="training")
    measured = drives("measured", roads_count=1, runs_count=60)
    sds_mu = np.full(len(measured), 0.0005)
    put(measured, name="trailer", kind="measured", role="measured", label_sd_mu=sds_mu)
    result = invoke("--challenger", "champion", "--champion", "champion", "--json")
    verdict = verdict_from_json(result.stdout)
    assert [each.role for each in verdict.holdouts] == ["known_roads", "unseen_roads", "manoeuvres", "measured"]
    # So certain are the labels that five per cent are many deviations: the uncertainty came along.
    assert {check.name for check in verdict.failures} == {"measured_truth"}


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["--challenger", "nowhere", "--holdout", "known_roads=known_roads.parquet"], ConfigurationError),
        (["--challenger", "champion"], ConfigurationError),
        (["--challenger", "champion", "--thresholds", "champion/manifest.json"], ThresholdsError),
    ],
)
def test_what_cannot_be_judged_is_an_error_and_leaves_nothing(inside, words, error):
    result = invoke(*words)
    assert isinstance(result.exception, error)
    assert not (inside / "lab" / "ledger.jsonl").exists()


def test_a_role_that_does_not_exist_is_refused(inside):
    result = invoke("--challenger", "champion", "--holdout", "parking=known_roads.parquet")
    assert result.exit_code == 2
    assert "parking" in result.output


def test_a_reference_is_the_path_of_a_folder(inside):
    lab = Laboratory(inside / "lab")
    assert resolve(lab, "champion").manifest.name == "linear"
    with pytest.raises(ConfigurationError, match="no folder"):
        resolve(lab, "champion", trees=inside / "trees")
