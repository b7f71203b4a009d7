"""The command `roadgrip-train evaluate`: what it prints and writes, what it refuses."""

import csv
import json

import pytest
from typer.testing import CliRunner

from roadgrip.section_file import section_to_json
from tests.bundles import make_bundle
from tests.training.recorded_drives import csv_of, drive, roads, write_folder
from training.cli import app, run

LABELS = "file,label_mu,section\nslow.csv,0.5,s-bend\nquick.csv,0.4,\n"


@pytest.fixture
def inside(tmp_path, monkeypatch):
    """A folder with drives and a bundle in it, and the current one."""
    monkeypatch.chdir(tmp_path)
    write_folder(tmp_path / "drives", LABELS)
    make_bundle(tmp_path / "bundle", weights={})
    return tmp_path


def _invoke(*arguments: str):
    return CliRunner().invoke(app, ["evaluate", *arguments])


def test_a_person_gets_tables(inside):
    result = _invoke("--bundle", "bundle", "--traces", "drives")
    assert result.exit_code == 0, result.output
    text = " ".join(result.stdout.split())
    assert "slow.csv │ s-bend │ 0.500 │ 0.500 │ 0.0 │ counted" in text
    assert "quick.csv │ s-bend │ 0.400 │ 0.500 │ 25.0 │ counted" in text
    assert "all estimates │ 2 │ 12.5" in text
    assert "hairpin │ 1 │ 0.444 to 0.556" in text


def test_machines_get_json_and_files(inside):
    result = _invoke("--bundle", "bundle", "--traces", "drives", "--out", "new/report", "--json")
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    report = inside / "new" / "report"
    assert document == json.loads((report / "report.json").read_text(encoding="utf-8"))
    assert document["errors"]["counted"]["passages_count"] == 2
    with (report / "passages.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["file"] for row in rows] == ["quick.csv", "slow.csv", "tight.csv"]
    page = (report / "report.html").read_text(encoding="utf-8")
    # The estimate that is furthest off is the one to look at.
    assert "quick.csv on s-bend, matched by" in page
    assert "Plotly.newPlot" in page


def test_sections_may_be_given_and_then_those_count(inside):
    (inside / "own.json").write_text(section_to_json(roads()[1]), encoding="utf-8")
    result = _invoke("--bundle", "bundle", "--traces", "drives", "--section", "own.json", "--json")
    document = json.loads(result.stdout)
    endings = {each["file"]: (each["ending"], each["reason"]) for each in document["passages"]}
    assert endings["tight.csv"] == ("counted", "")
    assert endings["quick.csv"] == ("refused_by_vehicle", "wrong_road")
    # It is said to be elsewhere, on a map that is not there.
    assert endings["slow.csv"] == ("unreadable", "")
    assert result.exit_code == 1


def test_one_file_that_cannot_be_read_is_told_and_the_others_are_not_lost(inside):
    (inside / "drives" / "broken.csv").write_bytes(csv_of(drive()).replace(b"steer_rad", b"steer", 1))
    result = _invoke("--bundle", "bundle", "--traces", "drives", "--json")
    assert result.exit_code == 1
    document = json.loads(result.stdout)
    assert document["endings"] == {"unreadable": 1, "counted": 3}
    assert "1 could not be read, such as broken.csv: no column steer_rad" in " ".join(result.stderr.split())


@pytest.mark.parametrize(
    ("arguments", "needle"),
    [
        (["--traces", "nowhere"], "no folder or file nowhere"),
        (["--traces", "drives", "--bundle", "drives"], "drives is no bundle: there is no manifest.json"),
        (["--traces", "drives", "--bundle", "nowhere"], "cannot read nowhere as a bundle"),
        (["--traces", "drives", "--section", "moon"], "no section 'moon'"),
        (["--traces", "drives", "--section", "s-turn", "--section", "s-turn"], "s-turn is given more than once"),
        (["--traces", "drives", "--vehicle", "car.toml"], "cannot read car.toml"),
        (["--traces", "drives", "--signals", "signals.toml"], "cannot read signals.toml"),
        (["--traces", "drives", "--format", "iac-av21"], "nothing can be read. quick.csv: no column"),
        (["--example", "drives"], "is there already; choose another folder"),
    ],
)
def test_what_cannot_be_is_one_line_and_exit_code_2(inside, arguments, needle, monkeypatch, capsys):
    bundle = [] if "--bundle" in arguments else ["--bundle", "bundle"]
    monkeypatch.setattr("sys.argv", ["roadgrip-train", "evaluate", *bundle, *arguments])
    with pytest.raises(SystemExit) as left:
        run()
    assert left.value.code == 2
    assert needle in " ".join(capsys.readouterr().err.split())


def test_a_bundle_that_was_tampered_with_is_refused(inside, monkeypatch, capsys):
    model = inside / "bundle" / "model.onnx"
    model.write_bytes(model.read_bytes() + b"!")
    monkeypatch.setattr("sys.argv", ["roadgrip-train", "evaluate", "--traces", "drives", "--bundle", "bundle"])
    with pytest.raises(SystemExit):
        run()
    assert "differs from its digest" in " ".join(capsys.readouterr().err.split())


def test_a_report_among_the_drives_would_be_taken_for_drives(inside):
    result = _invoke("--bundle", "bundle", "--traces", "drives", "--out", "drives/report")
    assert result.exit_code == 2
    assert "would be drives next time" in " ".join(result.output.replace("│", " ").split())
    assert not (inside / "drives" / "report").exists()


@pytest.mark.parametrize("arguments", [[], ["--traces", "drives", "--example", "new"]])
def test_drives_or_an_example_must_be_asked_for(inside, arguments):
    result = _invoke(*arguments)
    assert result.exit_code == 2
    assert "give recorded drives, or a folder for examples" in " ".join(result.output.replace("│", " ").split())
