"""The command `drift`: what it prints and writes, how it ends."""

import gzip
import json

import pytest
import typer
from typer.testing import CliRunner

from roadgrip.bundle import MANIFEST_NAME
from roadgrip.bundle_json import manifest_to_json
from roadgrip.errors import BundleError, ConfigurationError
from tests.training.drift.exported_traffic import export_of, passages_of, text_of, watched_manifest
from training.cli_drift import drift

MANIFEST = watched_manifest()
app = typer.Typer()
app.command()(drift)


@pytest.fixture
def inside(tmp_path, monkeypatch):
    """A folder with a bundle and two units' exports, and the current one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bundle").mkdir()
    (tmp_path / "bundle" / MANIFEST_NAME).write_text(manifest_to_json(MANIFEST), encoding="utf-8")
    still = export_of(MANIFEST, passages_of(MANIFEST, range(21), seed=1), unit="still")
    moved = export_of(MANIFEST, passages_of(MANIFEST, range(21), seed=2, changed_from_day=7), unit="moved")
    (tmp_path / "still.jsonl").write_text(text_of(still), encoding="utf-8")
    (tmp_path / "moved.jsonl.gz").write_bytes(gzip.compress(text_of(moved).encode()))
    return tmp_path


def invoke(*arguments: str):
    return CliRunner().invoke(app, [*arguments])


def test_unchanged_traffic_ends_with_0(inside):
    result = invoke("still.jsonl", "--bundle", "bundle")
    assert result.exit_code == 0, result.output
    assert "keep:" in result.stdout
    assert "still" in result.stdout


def test_a_recommendation_to_retrain_ends_with_1(inside):
    result = invoke("still.jsonl", "moved.jsonl.gz", "--bundle", "bundle")
    assert result.exit_code == 1, result.output
    assert "retrain:" in result.stdout
    assert "for several periods at 1 of 2 sections: bend (moved)" in result.stdout


def test_machines_get_json_and_files(inside):
    result = invoke("still.jsonl", "moved.jsonl.gz", "--bundle", "bundle", "--out", "new/drift", "--json")
    assert result.exit_code == 1, result.output
    document = json.loads(result.stdout)
    folder = inside / "new" / "drift"
    assert document == json.loads((folder / "drift.json").read_text(encoding="utf-8"))
    assert [each["unit"] for each in document["sections"]] == ["moved", "still"]
    assert "Plotly.newPlot" in (folder / "drift.html").read_text(encoding="utf-8")


def test_days_set_the_length_of_a_period(inside):
    document = json.loads(invoke("still.jsonl", "--bundle", "bundle", "--days", "3", "--json").stdout)
    assert document["period_s"] == 3 * 86_400.0
    assert len(document["sections"][0]["periods"]) == 7


def test_what_is_no_bundle_or_no_file_is_said(inside):
    assert isinstance(invoke("still.jsonl", "--bundle", ".").exception, BundleError)
    missing = invoke("nowhere.jsonl", "--bundle", "bundle").exception
    assert isinstance(missing, ConfigurationError)
    assert "nowhere.jsonl" in str(missing)
