"""`make mlops-demo` in a hurry: the operators' loop from nothing, every promise of it kept."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from deploy.rehearsal.commands import Operator, RehearsalError, Said
from deploy.rehearsal.run import MARK, prepare_folder
from deploy.rehearsal.warm import WarmPrograms

ROOT = Path(__file__).parents[2]


@pytest.mark.system
@pytest.mark.sim
@pytest.mark.long  # `make mlops-demo` plays this
@pytest.mark.timeout(900)
def test_the_operators_loop_goes_as_promised(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "deploy.rehearsal.run", "--quick", "--folder", str(tmp_path / "loop")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-6_000:] + done.stderr[-3_000:]
    assert "BROKEN" not in done.stdout
    assert len(re.findall(r"^kept ", done.stdout, flags=re.MULTILINE)) >= 15
    lab = tmp_path / "loop" / "lab"
    acts = [json.loads(line)["action"] for line in (lab / "ledger.jsonl").read_text(encoding="utf-8").splitlines()]
    assert acts.count("promoted") == 5
    assert (lab / "mlflow.db").exists()
    assert len(list(lab.glob("verdicts/*/verdict.html"))) == 2
    assert len(list(lab.glob("mlflow-files/**/verdicts/verdict.html"))) == 2


def test_only_what_a_rehearsal_left_is_thrown_away(tmp_path):
    (tmp_path / "mine").write_text("precious")
    with pytest.raises(RehearsalError, match="not empty"):
        prepare_folder(tmp_path)
    assert (tmp_path / "mine").exists()
    (tmp_path / MARK).touch()
    prepare_folder(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [MARK]


@pytest.mark.long
def test_a_command_that_fails_is_shown_with_what_it_said(tmp_path):
    shown: list[str] = []
    with WarmPrograms() as programs:
        operator = Operator(tmp_path, shown.append, programs)
        with pytest.raises(RehearsalError, match="code 2"):
            operator.types("roadgrip-train data show nothing --lab lab")
        told = operator.types("roadgrip-rsu --version").text
    assert shown == ["$ roadgrip-train data show nothing --lab lab", "$ roadgrip-rsu --version"]
    assert told.startswith("roadgrip ")


def test_the_json_of_a_command_is_found_behind_its_progress():
    assert Said(0, 'driving\n{"a": [1]}\n').document == {"a": [1]}
    with pytest.raises(RehearsalError, match="no JSON"):
        _ = Said(0, "nothing").document
