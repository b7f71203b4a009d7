"""Recordings of real cars under the packaged bundle: what `roadgrip-train evaluate` says of drives nobody made up."""

import json

from typer.testing import CliRunner

from roadgrip.section_file import section_to_json
from tests.replay.ferrari import curve_section_and_trace
from tests.replay.recordings import FERRARI, FOLDER, INDY, MOTORWAY, recording
from training.cli import app


def _only(*arguments):
    result = CliRunner().invoke(app, ["evaluate", *map(str, arguments), "--json"])
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    (passage,) = document["passages"]
    return passage, document


def test_a_racing_car_gets_an_estimate_that_moves_no_interval(tmp_path):
    section, _ = curve_section_and_trace()
    (tmp_path / "curve.json").write_text(section_to_json(section), encoding="utf-8")
    passage, document = _only(
        "--traces", FOLDER / FERRARI, "--format", "ferrari-250lm", "--section", tmp_path / "curve.json"
    )
    assert passage["ending"] == "not_counted"
    assert "out_of_envelope" in passage["not_counted"]
    assert set(passage["quality"]) >= {"no_gnss", "reference_speed"}
    assert document["intervals"] == []
    assert document["vehicle"] == "ferrari-250lm"


def test_cars_that_drove_elsewhere_are_refused():
    for name, recorded_as, hz in ((INDY, "iac-av21", 25.0), (MOTORWAY, "comma2k19-rav4", 100.0)):
        recording(name)  # skips where there is none
        passage, _ = _only("--traces", FOLDER / name, "--format", recorded_as)
        assert (passage["ending"], passage["reason"]) == ("refused_by_vehicle", "wrong_road")
        assert abs(passage["recorded_hz"] / hz - 1.0) < 0.05
