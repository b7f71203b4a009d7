"""The register of models, with bundles that are registered without being trained."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from rsu_app.adapters.inference import load_bundle
from tests.bundles import make_bundle
from training.laboratory import Laboratory
from training.retraining.registry import (
    MODEL_NAME,
    RegisterError,
    address_of,
    aliases,
    attach,
    models,
    registered,
    set_alias,
    shown_address,
)
from training.tracking import FILES_FOLDER_NAME, ModelRegister, Tracker, local_address

pytestmark = [pytest.mark.xdist_group("tracking"), pytest.mark.timeout(180)]


def register(lab: Laboratory, source: Path, *, bias_mu: float, trees: bool = False) -> str:
    """Register a bundle as a retraining does, and return its id."""
    bundle = make_bundle(source / "bundle", bias_mu=bias_mu)
    address = local_address(lab.folder)
    tracker = Tracker(address=address, experiment="test", files_folder=lab.folder / FILES_FOLDER_NAME)
    run = tracker.begin("a run", parameters={})
    run.folder(source / "bundle", "bundle")
    if trees:
        (source / "trees").mkdir()
        (source / "trees" / "friction-v2.json").write_text("{}")
        run.folder(source / "trees", "trees")
    words = {"bundle_id": bundle.bundle_id, "data.winter": "abc"}
    ModelRegister(address=address).add(MODEL_NAME, run_id=run.run_id, words=words, description="a bundle")
    run.end()
    return bundle.bundle_id


@pytest.fixture
def two(lab: Laboratory, tmp_path: Path) -> tuple[str, str]:
    first = register(lab, tmp_path / "first", bias_mu=0.5, trees=True)
    return first, register(lab, tmp_path / "second", bias_mu=0.6)


def test_an_empty_register_holds_nothing_and_says_so(lab):
    assert models(lab) == []
    assert aliases(lab) == {}
    with pytest.raises(RegisterError, match=r"no model 'champion' in the register; it holds none"):
        registered(lab, "champion")


def test_a_bundle_is_found_by_alias_version_and_id(lab, two):
    set_alias(lab, "champion", 1)
    for ref in ("champion", "1", two[0]):
        found = registered(lab, ref)
        assert (found.version, found.bundle_id, found.aliases) == (1, two[0], ("champion",))
        assert load_bundle(found.folder).manifest.bundle_id == two[0]
    assert registered(lab, "2").bundle_id == two[1]
    assert registered(lab, "2").aliases == ()


def test_trees_are_fetched_where_a_run_keeps_some(lab, two):
    trees = registered(lab, "1").trees_folder
    assert trees is not None
    assert [path.name for path in trees.iterdir()] == ["friction-v2.json"]
    assert registered(lab, "2").trees_folder is None


def test_the_newest_version_of_a_bundle_is_meant_by_its_id(lab, two, tmp_path):
    assert register(lab, tmp_path / "again", bias_mu=0.5) == two[0]
    assert registered(lab, two[0]).version == 3
    assert [(model.version, model.bundle_id) for model in models(lab)] == [(3, two[0]), (2, two[1]), (1, two[0])]


def test_an_alias_moves(lab, two):
    set_alias(lab, "challenger", 1)
    set_alias(lab, "canary", 1)
    set_alias(lab, "challenger", 2)
    assert aliases(lab) == {"challenger": 2, "canary": 1}
    assert [model.aliases for model in models(lab)] == [("challenger",), ("canary",)]


def test_an_alias_of_nothing_is_refused_with_what_there_is(lab, two):
    with pytest.raises(RegisterError, match=rf"no model '7' .*version 2 \({two[1]}\); version 1 \({two[0]}\)"):
        set_alias(lab, "champion", 7)
    assert aliases(lab) == {}


def test_a_fetched_bundle_is_used_without_its_run(lab, two):
    registered(lab, "1")
    shutil.rmtree(lab.folder / FILES_FOLDER_NAME)
    assert registered(lab, "1").bundle_id == two[0]
    assert [path.name for path in lab.bundles_folder.iterdir()] == [two[0]]


def test_a_fetched_bundle_that_was_changed_is_fetched_again(lab, two):
    model = registered(lab, "1").folder / "model.onnx"
    before = model.read_bytes()
    model.write_bytes(b"another")
    (registered(lab, "1").folder / "extra.onnx").write_bytes(b"more")
    assert load_bundle(registered(lab, "1").folder).manifest.bundle_id == two[0]
    assert model.read_bytes() == before


def test_a_bundle_that_was_changed_where_it_is_kept_is_refused(lab, two):
    for model in (lab.folder / FILES_FOLDER_NAME).rglob("model.onnx"):
        model.write_bytes(b"another")
    with pytest.raises(RegisterError, match=r"version 1 .* not what was registered: .*model.onnx differs"):
        registered(lab, "1")
    assert list(lab.bundles_folder.iterdir()) == []


def test_a_bundle_that_is_registered_under_another_id_is_refused(lab, tmp_path):
    register(lab, tmp_path / "first", bias_mu=0.5)
    ModelRegister(address=local_address(lab.folder)).say(MODEL_NAME, 1, {"bundle_id": "0" * 16})
    with pytest.raises(RegisterError, match="registered as 0000000000000000"):
        registered(lab, "1")


def test_a_verdict_is_kept_with_the_run_and_said_of_the_version(lab, two, tmp_path):
    verdict = tmp_path / "verdict.json"
    verdict.write_text('{"passed": true}')
    attach(lab, 1, [verdict], {"gate": "passed"})
    first = next(model for model in models(lab) if model.version == 1)
    assert first.words == {"data.winter": "abc", "gate": "passed"}
    (tmp_path / "kept").mkdir()
    assert ModelRegister(address=local_address(lab.folder)).fetch(first.run_id, "verdicts", tmp_path / "kept")
    assert (tmp_path / "kept" / "verdicts" / "verdict.json").read_text() == verdict.read_text()
    with pytest.raises(RegisterError, match="no model '9'"):
        attach(lab, 9, [verdict], {"gate": "passed"})


def test_the_records_are_where_one_is_told_then_where_the_environment_says_then_in_the_laboratory(lab, monkeypatch):
    assert address_of(lab) == f"sqlite:///{(lab.folder / 'mlflow.db').resolve()}"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://records.example")
    assert address_of(lab) == "http://records.example"
    assert address_of(lab, "http://others.example") == "http://others.example"


def test_a_password_in_an_address_is_not_shown():
    assert shown_address("postgresql://roads:secret@db.example:5432/mlflow") == "postgresql://db.example:5432/mlflow"
    assert shown_address("sqlite:////lab/mlflow.db") == "sqlite:////lab/mlflow.db"
