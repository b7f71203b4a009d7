"""The command `roadgrip-train`: what it says when something given to it cannot be, and what designs there are."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.training.runs import made_up_runs
from training.cli import app, run
from training.dataset import DatasetError, write_runs
from training.designs import DESIGNS


@pytest.mark.parametrize(
    ("arguments", "needle"),
    [
        (["simulate", "--runs", "1", "--out", "a-file"], "cannot use a-file"),
        (["fit", "runs.parquet", "--trees", "2", "--out", "a-file"], "cannot use a-file: File exists"),
        (["fit", "nowhere", "--out", "fit"], "roadgrip-train simulate"),
        (["cells", "nowhere"], "no finished design in nowhere; drive one"),
        (["cells", "begun"], "no finished design in begun; give its `roadgrip-train simulate` again"),
        (["cells", "."], "runs.parquet does not say which design it is"),
        (["export", "nowhere", "--data", "runs.parquet", "--out", "model.onnx"], "roadgrip-train fit"),
    ],
)
def test_what_cannot_be_is_one_line_and_exit_code_2(arguments, needle, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a-file").write_text("", encoding="utf-8")
    (tmp_path / "begun" / "shards").mkdir(parents=True)
    write_runs(made_up_runs(80), tmp_path / "runs.parquet", description={})
    monkeypatch.setattr("sys.argv", ["roadgrip-train", *arguments])
    with pytest.raises(SystemExit) as left:
        run()
    assert left.value.code == 2
    assert needle in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("arguments", "needle"),
    [
        (["--design", "moon"], "moon"),
        (["--design", "paper", "--section", "s-turn"], "one or the other"),
        (["--section", "s-turn", "--section", "s-turn"], "s-turn is given more than once"),
        (["--design", "manoeuvres", "--driver", "reacting"], "drivers of its own"),
        (["--design", "random-roads", "--random-roads", "0"], "nothing but random roads"),
    ],
)
def test_what_contradicts_itself_is_refused_by_name(arguments, needle, tmp_path):
    result = CliRunner().invoke(app, ["simulate", *arguments, "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert needle in " ".join(result.output.replace("│", " ").split())
    assert not (tmp_path / "out").exists()


def test_the_designs_are_listed_with_a_line_each():
    lines = CliRunner().invoke(app, ["designs"]).stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(DESIGNS)
    assert all(len(line) <= 120 for line in lines)
    assert set(json.loads(CliRunner().invoke(app, ["designs", "--json"]).stdout)) == set(DESIGNS)


ORIGIN = {"design": "paper", "seed": "1", "sensor_grade": "ideal", "driver_kind": "prudent", "kept_wanted_count": ""}


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    """A folder with a finished design in it."""
    folder = tmp_path / "finished"
    folder.mkdir()
    write_runs(made_up_runs(80), folder / "runs.parquet", description=ORIGIN)
    return folder


@pytest.mark.parametrize("other", ["--design straight", "--seed 2", "--sensors automotive", "--driver reacting"])
def test_a_finished_table_is_not_replaced_by_that_of_other_drives(finished, other):
    before = (finished / "runs.parquet").read_bytes()
    usual = "--seed 1 --sensors ideal --driver prudent --runs 1"
    result = CliRunner().invoke(app, ["simulate", "--out", str(finished), *usual.split(), *other.split()])
    assert isinstance(result.exception, DatasetError)
    assert "holds other drives (paper, prudent drivers, ideal sensors, seed 1)" in str(result.exception)
    assert (finished / "runs.parquet").read_bytes() == before


def test_two_data_sets_of_the_like_keep_a_table_each(finished, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    write_runs(made_up_runs(60), other / "runs.parquet", description={**ORIGIN, "seed": "2"})
    shown = CliRunner().invoke(app, ["cells", str(finished), str(other), str(other), "--json"]).stdout
    assert [(design["seed"], design["runs_count"]) for design in json.loads(shown)["designs"]] == [(1, 80), (2, 60)]


def test_a_picture_of_an_unknown_kind_is_refused_before_anything_is_written(finished, tmp_path):
    asked = ["cells", str(finished), "--out", str(tmp_path / "cells.json"), "--plot", str(tmp_path / "cells.doc")]
    result = CliRunner().invoke(app, asked)
    assert result.exit_code == 2
    assert ".svg, .png, .pdf" in " ".join(result.output.split())
    assert not (tmp_path / "cells.json").exists()


def test_figures_stay_whole_in_a_narrow_terminal(finished, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    shown = CliRunner().invoke(app, ["cells", str(finished)]).stdout
    assert "…" not in shown
    assert "│1.00│" in shown


@pytest.mark.parametrize(("absent", "code", "needle"), [("pyarrow", 2, "roadgrip[training]"), ("", 0, "roadgrip 0")])
def test_without_its_libraries_the_command_says_what_to_install(absent, code, needle):
    program = (
        f"import sys; sys.modules.update(dict.fromkeys({absent.split()})); import training.__main__ as m; m.main()"
    )
    done = subprocess.run([sys.executable, "-c", program, "--version"], capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert needle in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
