"""A retraining from the shelf to the register, on made-up drives."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roadgrip.bundle import BundleManifest
from roadgrip.bundle_json import manifest_from_json
from roadgrip.features import GRIP_TABLE, PAPER_TABLE
from roadgrip.ledger import Action, LedgerError, chain_problems
from rsu_app.adapters.inference import load_bundle
from tests.training.retraining.retrained_lab import (
    OWN_ROAD,
    QUICK,
    QUICKEST,
    TOOLS,
    data_of,
    measured_runs,
    measured_set,
    simulated_set,
    unseen_show,
)
from training.dataset import DatasetError
from training.laboratory import Laboratory
from training.regressor import estimate_mu
from training.retraining.drives import (
    LABEL_SCALE_RATIO,
    dealt_drives,
    fresh_roads,
    label_weight_ratio,
    own_drives,
    sensor_grades,
)
from training.retraining.registry import models, registered
from training.retraining.retrain import Retrained, RetrainOptions, bundle_of, retrained
from training.retraining.tree_files import read_tree_file
from training.table_models import FOLDS_COUNT
from training.tracking import DATABASE_FILE_NAME, ModelRegister, local_address

pytestmark = [pytest.mark.xdist_group("tracking"), pytest.mark.timeout(180)]


def retrain(lab: Laboratory, *names: str, options: RetrainOptions = QUICKEST, out: Path | None = None) -> Retrained:
    return retrained(
        lab, data_of(lab, *names), options, experiment="test", show=unseen_show, tools=TOOLS, reason="a test", out=out
    )


@pytest.fixture(scope="module")
def stocked(made_lab: Laboratory) -> Laboratory:
    simulated_set(made_lab, "roads")
    measured_set(made_lab, "trailer")
    return made_lab


@pytest.fixture(scope="module")
def done(stocked: Laboratory, tmp_path_factory: pytest.TempPathFactory) -> tuple[Retrained, Path]:
    out = tmp_path_factory.mktemp("out") / "bundle"
    options = replace(QUICK, local_sections=(OWN_ROAD,))
    return retrain(stocked, "roads", "trailer", options=options, out=out), out


@pytest.fixture(scope="module")
def files(stocked: Laboratory, done: tuple[Retrained, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("files")
    register = ModelRegister(address=local_address(stocked.folder))
    for folder in ("plots", "environment", "data", "trees"):
        assert register.fetch(done[0].run_id, folder, place)
    return place


def made(lab: Laboratory, folder: Path, *names: str, options: RetrainOptions = QUICKEST) -> BundleManifest:
    sets = data_of(lab, *names)
    drives = dealt_drives(sets, table=options.plans()[0].table, seed=options.seed)
    return bundle_of(sets, drives, options, folder, show=unseen_show, tools=TOOLS).manifest


def test_the_same_data_give_the_same_bundle_in_any_order(stocked, tmp_path):
    first = made(stocked, tmp_path / "one", "roads", "trailer")
    assert made(stocked, tmp_path / "other", "trailer", "roads") == first
    names = {path.name for path in (tmp_path / "one").iterdir()}
    assert names == {"manifest.json", "card.md", "friction-v1.onnx", "error-v1.onnx"}
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "other" / name).read_bytes()


@pytest.mark.long
def test_other_data_another_seed_and_other_trees_give_other_bundles(stocked, tmp_path):
    ids = {
        made(stocked, tmp_path / "a", "roads").bundle_id,
        made(stocked, tmp_path / "b", "roads", "trailer").bundle_id,
        made(stocked, tmp_path / "c", "roads", options=replace(QUICKEST, seed=2)).bundle_id,
        made(stocked, tmp_path / "d", "roads", options=replace(QUICKEST, trees_count=6)).bundle_id,
    }
    assert len(ids) == 4


def test_a_unit_can_load_what_was_retrained(done):
    result, out = done
    loaded = load_bundle(out)
    assert loaded.manifest == result.manifest
    assert loaded.manifest.table_digests == (GRIP_TABLE.digest, PAPER_TABLE.digest)
    assert all(model.conformal and model.error_model_file for model in loaded.manifest.models)


def test_a_section_gets_a_model_of_its_own_beside_the_global_one(done):
    manifest = done[0].manifest
    for digest, version in ((GRIP_TABLE.digest, "v2"), (PAPER_TABLE.digest, "v1")):
        here, elsewhere = (manifest.model_for(digest, section_id=name) for name in (OWN_ROAD, "long-turn"))
        assert here is not None
        assert elsewhere is not None
        assert (here.section_id, elsewhere.section_id) == (OWN_ROAD, None)
        assert here.model_file == f"friction-{version}-{OWN_ROAD}.onnx"
        assert here.conformal is not None
        assert elsewhere.conformal is not None
        assert here.conformal.doubtful_above_ratio == elsewhere.conformal.doubtful_above_ratio
        assert manifest.metrics[f"rows_count.local.{OWN_ROAD}.{version}"] == int(measured_runs(240).usable.sum())


def test_a_bundle_tells_units_what_its_training_was_like_there(done):
    result = done[0]
    sections = np.array(result.made.learned.runs.section_id)
    for model in result.manifest.models:
        here, anywhere = model.reference_for(OWN_ROAD), model.reference_for("elsewhere")
        assert here is not None
        assert anywhere is not None
        assert (here.section_id, here.rows_count) == (OWN_ROAD, int((sections == OWN_ROAD).sum()))
        assert anywhere.section_id is None
        assert anywhere.rows_count == (len(sections) if model.section_id is None else here.rows_count)


def test_a_section_with_few_drives_gets_no_model_of_its_own(stocked):
    with pytest.raises(DatasetError, match=r"drives on nowhere make no model of its own; at least 200 are needed"):
        retrain(stocked, "roads", options=replace(QUICKEST, local_sections=("nowhere",)))


def test_figures_tell_roads_frictions_sensors_data_sets_and_own_roads(done):
    metrics = done[0].manifest.metrics
    for version in ("v1", "v2"):
        for part in (
            "known_roads.long-turn",
            "unseen_roads.friction_40_50",
            "sensors.automotive",
            "sensors.measured",
            "set.roads",
            "set.trailer",
            "fresh_roads_automotive",
            f"own_roads.{OWN_ROAD}",
            f"own_roads_as_unseen.{OWN_ROAD}",
            f"local.{OWN_ROAD}",
        ):
            assert 0.0 < metrics[f"mape_ratio.{part}.{version}"] < 2.0, part
            assert 0.0 <= metrics[f"coverage_frac.{part}.{version}"] <= 1.0


def test_a_registered_challenger_is_fetched_with_its_trees(stocked, done):
    found = registered(stocked, "challenger")
    assert (found.bundle_id, found.run_id) == (done[0].manifest.bundle_id, done[0].run_id)
    assert load_bundle(found.folder).manifest == done[0].manifest
    assert found.trees_folder is not None
    model = done[0].made.models[0]
    kept = read_tree_file(found.trees_folder / "friction-v2.json")
    assert kept.column_names == model.plan.column_names
    rows = done[0].made.learned.runs.columns(model.plan.features)[:50]
    assert (estimate_mu(kept.trees, rows) == estimate_mu(model.friction, rows)).all()


def test_the_run_keeps_pictures_environment_cards_and_trees(files):
    names = {path.relative_to(files).as_posix() for path in files.rglob("*") if path.is_file()}
    assert {"plots/error-by-road.svg", "plots/error-by-friction.svg"} <= names
    assert {f"plots/{kind}-v{version}.svg" for kind in ("estimates", "features") for version in (1, 2)} <= names
    assert {"environment/environment.json", "environment/requirements.txt"} <= names
    assert {"data/roads.json", "data/trailer.json"} <= names
    assert {
        f"trees/{kind}-v{v}{road}.json"
        for kind in ("friction", "error")
        for v in (1, 2)
        for road in ("", f"-{OWN_ROAD}")
    } <= names
    assert json.loads((files / "environment/environment.json").read_text())["code.digest"]
    assert "xgboost-cpu==" in (files / "environment/requirements.txt").read_text()


def test_the_ledger_says_which_data_taught_which_bundle(stocked, done):
    entries = [entry for entry in stocked.ledger() if entry.subject == done[0].manifest.bundle_id]
    assert [entry.action for entry in entries] == [Action.RETRAINED]
    assert entries[0].evidence["mlflow_run"] == done[0].run_id
    assert entries[0].evidence["version"] == str(done[0].version)
    assert {"data.roads", "data.trailer", "code.digest"} <= set(entries[0].evidence)
    assert chain_problems(stocked.ledger()) == []


ASK = """
import sys, json
import mlflow, numpy, pandas
mlflow.set_tracking_uri(sys.argv[1])
model = mlflow.pyfunc.load_model("models:/roadgrip-global@challenger")
told = json.load(sys.stdin)
names = model.metadata.get_input_schema().input_names()
answers = model.predict(pandas.DataFrame(numpy.array(told, dtype="float32"), columns=names))
example = model.input_example
print(json.dumps({"names": names, "mu": answers["mu"].tolist(), "error": answers["expected_error_ratio"].tolist(),
    "example_count": len(example), "outputs": model.metadata.get_output_schema().input_names()}))
"""


@pytest.mark.system
def test_mlflow_loads_the_challenger_and_answers_as_the_bundle_does(stocked, done):
    model = done[0].manifest.models[0]
    asked = subprocess.run(
        [sys.executable, "-c", ASK, local_address(stocked.folder)],
        input=json.dumps(model.golden.rows),
        env={**os.environ, "MLFLOW_DISABLE_TELEMETRY": "true"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert asked.returncode == 0, asked.stderr
    told = json.loads(asked.stdout)
    assert told["names"] == list(model.feature_names)
    assert told["outputs"] == ["mu", "expected_error_ratio"]
    assert told["mu"] == pytest.approx(model.golden.mu, abs=1e-6)
    assert told["error"] == pytest.approx(model.golden.expected_error_ratio, abs=1e-6)
    assert told["example_count"] == 5


def test_a_retraining_that_fails_leaves_a_failed_run_and_no_version(lab):
    simulated_set(lab, "one", count=500)
    with pytest.raises(DatasetError, match="no model of its own"):
        retrain(lab, "one", options=replace(QUICKEST, local_sections=("nowhere",)))
    with closing(sqlite3.connect(lab.folder / DATABASE_FILE_NAME)) as database:
        assert database.execute("select status from runs").fetchall() == [("FAILED",)]
    assert models(lab) == []
    assert lab.ledger() == []


def test_a_broken_ledger_is_found_before_anything_is_grown(lab):
    simulated_set(lab, "one", count=500)
    lab.ledger_path.write_text("nonsense\n")
    with pytest.raises(LedgerError):
        retrain(lab, "one")
    with closing(sqlite3.connect(lab.folder / DATABASE_FILE_NAME)) as database:
        assert database.execute("select count(*) from runs").fetchall() == [(0,)]


def test_a_bundle_takes_the_place_of_another_one_in_its_folder(lab, done, tmp_path):
    simulated_set(lab, "one", count=500)
    out = tmp_path / "bundle"
    shutil.copytree(done[1], out)
    result = retrain(lab, "one", out=out)
    assert load_bundle(out).manifest == result.manifest


def test_too_few_random_roads_are_refused_with_what_to_do(lab):
    measured_set(lab, "trailer")
    with pytest.raises(DatasetError, match=r"^0 random roads with drives; at least 11 are needed.*Simulate some"):
        retrain(lab, "trailer")


def test_an_unknown_feature_table_is_refused(lab):
    simulated_set(lab, "one", count=500)
    with pytest.raises(DatasetError, match="no model is made for feature table 9; there are 1 and 2"):
        retrain(lab, "one", options=replace(QUICKEST, tables=(1, 9)))


def test_a_manifest_tells_how_to_make_it_again(done):
    result, out = done
    said = manifest_from_json((out / "manifest.json").read_text()).provenance
    digests = sorted(said[f"data.{name}"] for name in ("roads", "trailer"))
    command = f"roadgrip-train retrain --data {digests[0]} --data {digests[1]} --trees 20 --depth 4 --local {OWN_ROAD}"
    assert said["command"] == command
    assert said["fit.v2"] == str(result.made.models[0].plan.parameters)


# What is learned from, and what judges ------------------------------------------------------------------------------


def test_fresh_roads_are_driven_by_nobody_who_teaches(stocked):
    dealt = dealt_drives(data_of(stocked, "roads", "trailer"), table=GRIP_TABLE, seed=1)
    fresh = set(dealt.unseen.section_id)
    assert len(fresh) == 1
    assert fresh.isdisjoint(dealt.learned.runs.section_id)
    assert set(dealt.fresh) == {"fresh_roads_automotive"}


def test_own_roads_are_measured_ones_and_those_with_a_name_of_their_own():
    runs = replace(measured_runs(4), section_id=("long-turn", "long-turn", "random-1-0001", OWN_ROAD))
    own = own_drives(runs, measured=np.array([True, False, False, False]))
    assert own.tolist() == [True, False, False, True]


def test_drives_of_an_own_road_are_dealt_out_one_by_one(stocked):
    learned = dealt_drives(data_of(stocked, "roads", "trailer"), table=GRIP_TABLE, seed=1).learned
    there = np.array(learned.runs.section_id) == OWN_ROAD
    assert set(learned.fold[there].tolist()) == set(range(FOLDS_COUNT))
    assert learned.known[there].all()
    assert learned.own is not None
    assert (learned.own == there).all()


def test_what_two_data_sets_bring_counts_once(lab):
    one, other = simulated_set(lab, "one", count=500), simulated_set(lab, "more", count=600)
    assert one.digest != other.digest
    sets = data_of(lab, "one", "more")
    shared = set(map(bytes, sets[0].runs.features[sets[0].runs.usable])) & set(
        map(bytes, sets[1].runs.features[sets[1].runs.usable])
    )
    dealt = dealt_drives(sets, table=GRIP_TABLE, seed=1)
    taught = len(dealt.learned.runs) + len(dealt.unseen)
    assert dealt.repeated_count == len(shared)
    assert taught + dealt.repeated_count == sum(int(each.runs.usable.sum()) for each in sets)


def test_an_uncertain_label_counts_less(stocked):
    trailer = data_of(stocked, "trailer")[0]
    weight = label_weight_ratio(trailer)
    usable = trailer.runs.usable
    assert trailer.label_sd_mu is not None
    relative = trailer.label_sd_mu / trailer.runs.labels["label_mu"]
    order = np.argsort(relative[usable])
    assert (np.diff(weight[usable][order]) <= 0.0).all()
    exact = replace(trailer, label_sd_mu=LABEL_SCALE_RATIO * trailer.runs.labels["label_mu"])
    assert label_weight_ratio(exact)[usable] == pytest.approx(0.5)
    assert (label_weight_ratio(data_of(stocked, "roads")[0]) == 1.0).all()


def test_weights_are_one_in_the_mean_and_follow_their_drives(stocked):
    learned = dealt_drives(data_of(stocked, "roads", "trailer"), table=GRIP_TABLE, seed=1).learned
    assert learned.weight_ratio is not None
    assert learned.weight_ratio.mean() == pytest.approx(1.0)
    there = np.array(learned.runs.section_id) == OWN_ROAD
    assert learned.weight_ratio[there].max() < learned.weight_ratio[~there].min()
    exact = dealt_drives(data_of(stocked, "roads"), table=GRIP_TABLE, seed=1).learned
    assert exact.weight_ratio is None


def test_the_grade_of_sensors_is_told_by_the_data_set_and_by_exact_drives(stocked):
    roads, trailer = data_of(stocked, "roads", "trailer")
    assert set(sensor_grades(roads).tolist()) == {"automotive"}
    assert set(sensor_grades(trailer).tolist()) == {"measured"}
    exact = replace(roads, runs=replace(roads.runs, scenario=("random-1-exact",) * len(roads.runs)))
    assert set(sensor_grades(exact).tolist()) == {"ideal"}


def test_ten_roads_are_left_to_learn_from_however_few_there_are():
    runs = replace(measured_runs(110), section_id=tuple(f"random-{i % 11:02d}" for i in range(110)))
    nothing = np.zeros(110, dtype=np.bool_)
    fresh = fresh_roads(runs, runs.usable, own=nothing, seed=1)
    assert len(set(np.array(runs.section_id)[runs.usable & ~fresh].tolist())) == 10
