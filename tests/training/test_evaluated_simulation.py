"""Simulated drives as if somebody had recorded them: evaluation finds what the laboratory's own table holds."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from roadgrip.records import KinematicSummary
from roadgrip.sections import read_section
from tests.bundles import make_bundle
from training.cli import app
from training.dataset import COMPLETED
from training.evaluation import RecordedDrive, driven_passage
from training.passage_rows import rows_of
from training.scenarios import Design, Scenario, Terms, attempted, run_of
from training.simulation import drive_design
from training.trace_folder import drives_of, open_folder
from vehicle_client.recording.csv_table import csv_of_columns
from vehicle_client.recording.own_columns import columns_of_trace
from vehicle_client.simulator.plan import SensorGrade
from vehicle_client.simulator.run import each_passage

pytestmark = [pytest.mark.sim, pytest.mark.xdist_group("sim")]

SECTION = read_section("s-turn")
TERMS = Terms("test", 4, SensorGrade.AUTOMOTIVE)
SCENARIO = Scenario("s-turn", SECTION, attempted(3), two_frictions=True)


def test_a_recorded_drive_gives_the_row_of_the_laboratory_to_the_last_bit(tmp_path: Path) -> None:
    runs = [run_of(TERMS, SCENARIO, base_friction_mu=0.6, number=number) for number in range(3)]
    drives = list(each_passage(SECTION, [run.plan for run in runs]))
    rows = rows_of(SCENARIO, runs, drives, road_map=SECTION)
    assert COMPLETED in rows.outcome
    for number, drive in enumerate(drives):
        columns = columns_of_trace(drive.trace) | {"label_mu": drive.truth.friction_mu}
        (tmp_path / f"{number}.csv").write_bytes(csv_of_columns(columns))
    source = open_folder(tmp_path)
    for number, file in enumerate(source.files):
        (recorded,) = drives_of(file, source)
        assert isinstance(recorded, RecordedDrive)
        driven = driven_passage(recorded, (SECTION,))
        if rows.outcome[number] != COMPLETED:
            continue
        assert isinstance(driven.found, KinematicSummary)
        assert driven.found.values == tuple(rows.features[number].tolist()[: len(driven.found.values)])
        # The label is the lowest 10 m of what the tyres found, as in the laboratory.
        assert driven.label_mu == pytest.approx(drives[number].label_mu, rel=0.01)


def test_raw_drives_of_a_design_are_read_with_their_labels_and_maps(tmp_path: Path) -> None:
    design = Design(TERMS, (SCENARIO,), (0.6,))
    runs = drive_design(design, tmp_path / "raw", workers_count=1, with_drives=True)
    make_bundle(tmp_path / "bundle", weights={})
    asked = ["evaluate", "--traces", str(tmp_path / "raw"), "--bundle", str(tmp_path / "bundle"), "--json"]
    result = CliRunner().invoke(app, asked)
    assert result.exit_code == 0, result.output
    told = {each["file"].partition("#")[2]: each for each in json.loads(result.stdout)["passages"]}
    assert set(told) == set(runs.run_key)
    for i, key in enumerate(runs.run_key):
        assert told[key]["label_mu"] == pytest.approx(runs.labels["label_mu"][i])
        assert told[key]["group"] == "base friction 0.60"
        assert (told[key]["ending"] == "counted") is (runs.outcome[i] == COMPLETED)


def test_the_example_is_evaluated_as_it_is_written(tmp_path: Path) -> None:
    written = CliRunner().invoke(app, ["evaluate", "--example", str(tmp_path / "drives"), "--json"])
    assert written.exit_code == 0, written.output
    result = CliRunner().invoke(app, ["evaluate", "--traces", str(tmp_path / "drives"), "--json"])
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert [each["ending"] for each in document["passages"]] == ["counted"] * 3
    assert document["errors"]["counted"]["worst_ratio"] < 0.5
    assert len(document["intervals"]) == 3
