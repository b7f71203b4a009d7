"""The command `roadgrip-train`: what it says when something given to it cannot be, and what designs there are."""

import json

import pytest
from typer.testing import CliRunner

from tests.training.runs import made_up_runs
from training.__main__ import app, main
from training.dataset import write_runs
from training.designs import DESIGNS


@pytest.mark.parametrize(
    ("arguments", "needle"),
    [
        (["simulate", "--runs", "1", "--out", "a-file"], "cannot use a-file"),
        (["fit", "runs.parquet", "--trees", "2", "--out", "a-file"], "cannot use a-file: File exists"),
        (["fit", "nowhere", "--out", "fit"], "roadgrip-train simulate"),
        (["cells", "nowhere"], "no finished design in nowhere"),
        (["export", "nowhere", "--data", "runs.parquet", "--out", "model.onnx"], "roadgrip-train fit"),
    ],
)
def test_what_cannot_be_is_one_line_and_exit_code_2(arguments, needle, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a-file").write_text("", encoding="utf-8")
    write_runs(made_up_runs(80), tmp_path / "runs.parquet", description={})
    monkeypatch.setattr("sys.argv", ["roadgrip-train", *arguments])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 2
    assert needle in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("arguments", "needle"),
    [
        (["--design", "moon"], "moon"),
        (["--design", "paper", "--section", "s-turn"], "one or the other"),
        (["--design", "manoeuvres", "--driver", "reacting"], "drivers of its own"),
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
