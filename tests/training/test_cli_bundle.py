"""The steps to a bundle on either feature table, and the default bundle in one go from a tiny design."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from roadgrip.features import GRIP_TABLE, PAPER_TABLE, TABLES
from rsu_app.adapters.inference import load_bundle
from tests.training.runs import made_up_runs
from training.cli import app
from training.dataset import write_runs


def invoke(*words: object) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.mark.parametrize("table", TABLES.values(), ids=lambda table: f"table {table.version}")
def test_the_steps_lead_to_a_bundle_of_the_table_that_was_fitted(table, tmp_path: Path) -> None:
    runs, fit = tmp_path / "runs.parquet", tmp_path / "fit"
    write_runs(made_up_runs(300), runs, description={})
    invoke("fit", runs, "--out", fit, "--trees", 3, "--table", table.version)
    invoke("export", fit, "--data", runs, "--out", tmp_path / "model.onnx")
    invoke("bundle", runs, "--fit", fit, "--out", tmp_path / "bundle")
    assert load_bundle(tmp_path / "bundle").manifest.table_digests == (table.digest,)


def test_a_table_that_is_not_spoken_is_refused_by_name(tmp_path: Path) -> None:
    write_runs(made_up_runs(80), tmp_path / "runs.parquet", description={})
    words = ["fit", str(tmp_path / "runs.parquet"), "--out", str(tmp_path / "fit"), "--table", "99"]
    assert "no feature table 99" in " ".join(CliRunner().invoke(app, words).output.split())


@pytest.mark.sim
@pytest.mark.long
def test_the_default_bundle_of_a_tiny_design_serves_both_tables(tmp_path: Path) -> None:
    out = tmp_path / "bundle"
    told = json.loads(
        invoke("default-bundle", "--runs", 3, "--random-roads", 12, "--work", tmp_path / "work", "--out", out, "--json")
    )
    manifest = load_bundle(out).manifest
    assert manifest.bundle_id == told["bundle_id"]
    assert manifest.table_digests == (GRIP_TABLE.digest, PAPER_TABLE.digest)
    for version in (1, 2):
        for part in (
            "known_roads",
            "unseen_roads",
            "fresh_roads_automotive",
            "fresh_roads_automotive_remembering",
            "fresh_roads_ideal",
        ):
            assert 0.0 < manifest.metrics[f"mape_ratio.{part}.v{version}"] < 1.0
    assert manifest.bundle_id in invoke("card", out)
