"""The commands `roadgrip-train data` and `ground-truth`: what they keep, what they refuse, what they tell."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner, Result

from roadgrip.features import GRIP_TABLE, PAPER_TABLE
from roadgrip.section_file import section_to_json
from tests.rsu_app.fakes import NOON_UNIX_S
from tests.training.data.exports import BEND, exported, head_of, write_export
from tests.training.runs import made_up_runs
from training.cli_data import data_app
from training.cli_ground_truth import ground_truth_app
from training.data.data_shelf import HoldOutError, Role, add_data_set, data_cards, read_data_set, training_sets
from training.data.exported_passages import PassageReason
from training.data.ground_truth import GroundTruthError, RowReason
from training.data.ground_truth_shelf import ground_truth_cards
from training.data.hold_outs import hold_out_name
from training.data.shelf import ShelfError
from training.dataset import write_runs
from training.laboratory import Laboratory

HEADER = "section_id,from_utc,until_utc,mu,mu_sd,instrument"
ROW = "bend,2026-01-01T11:30:00Z,2026-01-01T12:30:00Z,0.40,0.02,ViaFriction 3"
WORDS = ("--origin", "road authority", "--licence", "CC0-1.0")
COMMAND = "roadgrip-train data holdouts --seed 3 --runs 1 --random-roads 1"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROADGRIP_LAB", "the-lab")
    return tmp_path


@pytest.fixture
def lab(folder: Path) -> Laboratory:
    return Laboratory(folder / "the-lab")


def invoke(app: typer.Typer, *words: object) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def told_by(app: typer.Typer, *words: object) -> Any:
    result = invoke(app, *words, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def imported(folder: Path, *rows: str, name: str = "week-5") -> Any:
    (folder / f"{name}.csv").write_text("\n".join([HEADER, *rows]), encoding="utf-8")
    return told_by(ground_truth_app, "import", f"{name}.csv", *WORDS)


def rows_of(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"))))


# Ground truth ---------------------------------------------------------------------------------------------------------


def test_a_trailers_table_goes_on_the_shelf_under_its_files_name(folder, lab):
    told = imported(folder, ROW)
    (card,) = ground_truth_cards(lab)
    assert told["card"]["digest"] == card.digest
    assert (card.name, card.origin, card.licence, card.measurements_count) == ("week-5", "road authority", "CC0-1.0", 1)
    assert told["refused"] == {}
    assert told["refused_file"] is None


def test_refused_rows_are_counted_by_reason_and_written_with_their_lines(folder):
    told = imported(folder, ROW, ROW, ROW.replace("0.40", "40"), ROW.replace("0.40", "41"))
    assert told["refused"] == {"duplicate": 1, "out_of_range": 2}
    refused = rows_of(folder / told["refused_file"])
    assert [(row["line_number"], row["reason"]) for row in refused] == [
        ("3", "duplicate"),
        ("4", "out_of_range"),
        ("5", "out_of_range"),
    ]
    assert Path(told["refused_file"]) == Path("the-lab/data/refused/week-5.csv")


def test_the_report_for_a_person_names_reasons_examples_and_the_file(folder):
    (folder / "week-5.csv").write_text("\n".join([HEADER, ROW, ROW.replace("0.40", "40")]), encoding="utf-8")
    result = invoke(ground_truth_app, "import", "week-5.csv", *WORDS, "--refused", "bad/rows.csv")
    assert result.exit_code == 0
    assert "out_of_range" in result.stdout
    assert "line 3" in result.stdout
    assert "bad/rows.csv" in result.stdout
    assert len(rows_of(folder / "bad/rows.csv")) == 1


def test_a_table_of_refused_rows_alone_ends_with_code_one(folder, lab):
    (folder / "week-5.csv").write_text("\n".join([HEADER, ROW.replace("0.40", "40")]), encoding="utf-8")
    result = invoke(ground_truth_app, "import", "week-5.csv", *WORDS, "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["card"] is None
    assert len(rows_of(folder / "the-lab/data/refused/week-5.csv")) == 1
    assert ground_truth_cards(lab) == []


def test_what_is_no_table_is_an_error_of_ours(folder):
    (folder / "week-5.csv").write_text("friction\n", encoding="utf-8")
    assert isinstance(invoke(ground_truth_app, "import", "week-5.csv", *WORDS).exception, GroundTruthError)


def test_tables_are_listed(folder):
    card = imported(folder, ROW)["card"]
    assert told_by(ground_truth_app, "list") == [card]
    shown = invoke(ground_truth_app, "list").stdout
    assert card["digest"] in shown
    assert "2026-01-01 11:30 UTC" in shown


# Simulated drives -----------------------------------------------------------------------------------------------------


def test_simulated_drives_go_on_the_shelf_with_what_made_them(folder, lab):
    told = {"command": "roadgrip-train simulate --seed 1", "seed": "1", "wall_s": "3.1"}
    write_runs(made_up_runs(40), folder / "runs.parquet", description=told)
    (card,) = told_by(data_app, "add", folder, "--name", "mixed", "--licence", "CC0-1.0")
    assert (card["kind"], card["role"], card["origin"]) == ("simulated", "training", "roadgrip-train simulate --seed 1")
    assert card["made_from"] == {"command": "roadgrip-train simulate --seed 1", "seed": "1"}
    assert read_data_set(lab, "mixed").runs.digest() == made_up_runs(40).digest()


def test_drives_that_do_not_say_what_made_them_need_an_origin(folder):
    write_runs(made_up_runs(40), folder / "runs.parquet", description={})
    words = ("add", folder, "--name", "mixed", "--licence", "CC0-1.0")
    refused = invoke(data_app, *words)
    assert refused.exit_code == 2
    assert "--origin" in refused.output
    assert told_by(data_app, *words, "--origin", "somebody")[0]["origin"] == "somebody"


def test_a_hold_out_is_added_by_its_role(folder, lab):
    write_runs(made_up_runs(40), folder / "runs.parquet", description={"command": "made up"})
    told_by(data_app, "add", folder, "--name", "judge", "--licence", "CC0-1.0", "--role", "known_roads")
    with pytest.raises(HoldOutError):
        training_sets(lab, ["judge"])


# Passages from the road -----------------------------------------------------------------------------------------------


def joined(*words: object) -> Any:
    return told_by(data_app, "join", "--ground-truth", "week-5", "--name", "road", *words)


def test_exported_passages_get_what_the_trailer_measured(folder, lab):
    truth = imported(folder, ROW)["card"]
    write_export(folder / "a.jsonl.gz", [exported(0), exported(1, left_unix_s=0.0)])
    write_export(folder / "b.jsonl", [exported(2), exported(0)], head=head_of(BEND, unit="unit-2"))
    told = joined("--export", "a.jsonl.gz", "--export", "b.jsonl")
    assert told["refused"] == {"no_measurement": 1, "repeated": 1}
    (card,) = told["data_sets"]
    assert (card["name"], card["kind"], card["role"], card["usable_count"]) == ("road-v2", "measured", "training", 2)
    assert (card["licence"], card["origin"]) == ("CC0-1.0", "road authority; passages of unit-1, unit-2")
    assert card["made_from"]["ground_truth"] == truth["digest"]
    assert card["made_from"]["ledger_head.unit-1"] == "ab" * 32
    data_set = read_data_set(lab, "road-v2")
    assert data_set.runs.labels["label_mu"].tolist() == [pytest.approx(0.36)] * 2
    assert data_set.label_sd_mu is not None
    assert [(row["export"], row["line_number"]) for row in rows_of(folder / told["refused_file"])] == [
        ("a.jsonl.gz", "3"),
        ("b.jsonl", "3"),
    ]


def test_each_feature_table_is_a_data_set_of_its_own(folder, lab):
    imported(folder, ROW)
    write_export(folder / "a.jsonl", [exported(0), exported(1, table=PAPER_TABLE)])
    assert {card["name"] for card in joined("--export", "a.jsonl")["data_sets"]} == {"road-v1", "road-v2"}
    assert read_data_set(lab, "road-v1").runs.table == PAPER_TABLE
    assert read_data_set(lab, "road-v2").runs.table == GRIP_TABLE


def test_all_rows_can_be_cut_to_one_table(folder, lab):
    imported(folder, ROW)
    write_export(folder / "a.jsonl", [exported(0), exported(1, table=PAPER_TABLE)])
    joined("--export", "a.jsonl", "--table", 1)
    assert [(card.name, card.usable_count) for card in data_cards(lab)] == [("road-v1", 2)]
    unknown = invoke(data_app, "join", "--ground-truth", "week-5", "--name", "x", "--export", "a.jsonl", "--table", 9)
    assert unknown.exit_code == 2
    assert "no feature table 9" in unknown.output


def test_a_map_that_no_export_holds_is_given_as_a_file(folder):
    imported(folder, ROW)
    write_export(folder / "a.jsonl", [exported(0)], head=head_of())
    assert invoke(data_app, "join", "--ground-truth", "week-5", "--name", "road", "--export", "a.jsonl").exit_code == 1
    (folder / "bend.json").write_text(section_to_json(BEND), encoding="utf-8")
    assert joined("--export", "a.jsonl", "--section", "bend.json")["data_sets"][0]["usable_count"] == 1


def test_slack_and_wear_are_options_that_the_card_tells(folder, lab):
    imported(folder, ROW)
    write_export(folder / "a.jsonl", [exported(0), exported(1, left_unix_s=NOON_UNIX_S + 1900.0)])
    told = joined("--export", "a.jsonl", "--slack-s", 0, "--wear-ratio", 0.95)
    assert told["refused"] == {"no_measurement": 1}
    assert told["data_sets"][0]["made_from"]["slack_s"] == "0"
    assert told["data_sets"][0]["label_kind"] == "trailer measurement times 0.95 for wear"
    assert read_data_set(lab, "road-v2").runs.labels["label_mu"].tolist() == [pytest.approx(0.38)]


def test_measured_passages_can_be_held_out(folder, lab):
    imported(folder, ROW)
    write_export(folder / "a.jsonl", [exported(0)])
    joined("--export", "a.jsonl", "--role", "measured")
    with pytest.raises(HoldOutError):
        training_sets(lab, ["road-v2"])


def test_a_join_that_finds_nothing_ends_with_code_one_and_says_why(folder, lab):
    imported(folder, ROW)
    write_export(folder / "a.jsonl", [exported(0, left_unix_s=0.0)])
    result = invoke(data_app, "join", "--ground-truth", "week-5", "--name", "road", "--export", "a.jsonl")
    assert result.exit_code == 1
    assert "no_measurement" in result.stdout
    assert "no passage got a measured friction" in result.stdout
    assert data_cards(lab) == []


# The shelf ------------------------------------------------------------------------------------------------------------


def put(lab: Laboratory, name: str, *, seed: int = 0, role: str = "training", command: str = "made up") -> str:
    return add_data_set(
        lab,
        made_up_runs(20, seed=seed),
        name=name,
        kind="simulated",
        role=role,
        origin=command,
        licence="CC0-1.0",
        label_kind="simulated friction",
        made_from={"command": command},
    ).digest


def test_data_sets_are_listed_and_shown(lab):
    digest = put(lab, "mixed")
    assert digest in invoke(data_app, "list").stdout
    assert [card["name"] for card in told_by(data_app, "list")] == ["mixed"]
    assert json.loads(invoke(data_app, "show", digest[:5]).stdout)["digest"] == digest
    assert isinstance(invoke(data_app, "show", "other").exception, ShelfError)


def test_verify_tells_what_has_changed(folder, lab):
    digest, _ = put(lab, "mixed"), put(lab, "more", seed=1)
    truth = imported(folder, ROW)["card"]["digest"]
    assert told_by(data_app, "verify") == {"checked_count": 3, "changed": {}}
    write_runs(made_up_runs(20, seed=2), lab.data_folder / digest / "runs.parquet", description={})
    path = lab.data_folder / "ground-truth" / truth / "measurements.csv"
    path.chmod(0o644)
    path.write_text(path.read_text(encoding="utf-8").replace("0.4", "0.5"), encoding="utf-8")
    result = invoke(data_app, "verify", "--json")
    assert result.exit_code == 1
    assert set(json.loads(result.stdout)["changed"]) == {digest, truth}
    assert "has changed since" in invoke(data_app, "verify").stdout


# Hold-outs ------------------------------------------------------------------------------------------------------------

SIMULATED = (Role.KNOWN_ROADS, Role.UNSEEN_ROADS, Role.MANOEUVRES)
SMALLEST = ("holdouts", "--seed", 3, "--runs", 1, "--random-roads", 1)


def test_hold_outs_that_are_there_stay_as_they_are(lab):
    digests = [put(lab, hold_out_name(role), seed=i, role=role, command=COMMAND) for i, role in enumerate(SIMULATED)]
    assert [card["digest"] for card in told_by(data_app, *SMALLEST)] == digests
    error = invoke(data_app, *SMALLEST[:-1], 2).exception
    assert isinstance(error, ShelfError)
    assert "hold-outs are frozen" in str(error)


@pytest.mark.sim
@pytest.mark.long
@pytest.mark.xdist_group("sim")
def test_hold_outs_are_driven_and_kept_with_their_roles(folder, lab):
    cards = told_by(data_app, *SMALLEST)
    assert [(card["name"], card["role"]) for card in cards] == [(hold_out_name(role), role) for role in SIMULATED]
    assert all(card["usable_count"] > 0 and card["made_from"]["command"] == COMMAND for card in cards)
    again = told_by(data_app, *SMALLEST)
    assert again == cards
    for card in cards:
        with pytest.raises(HoldOutError):
            training_sets(lab, [card["digest"]])


def test_the_page_lists_every_reason_and_every_role(project_root):
    page = (project_root / "docs" / "data-sets.md").read_text(encoding="utf-8")
    words = [*RowReason, *PassageReason, *Role]
    assert [word for word in words if f"`{word}`" not in page] == []
