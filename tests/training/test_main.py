"""The command `roadgrip-train`: what it says when something given to it cannot be."""

import pytest

from tests.training.runs import made_up_runs
from training.__main__ import main
from training.dataset import write_runs


@pytest.mark.parametrize(
    ("arguments", "needle"),
    [
        (["simulate", "--runs", "1", "--out", "a-file"], "cannot use a-file: File exists"),
        (["fit", "runs.parquet", "--trees", "2", "--out", "a-file"], "cannot use a-file: File exists"),
        (["fit", "nowhere", "--out", "fit"], "roadgrip-train simulate"),
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
