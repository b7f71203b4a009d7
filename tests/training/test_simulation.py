from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from roadgrip.bundle import manifest_from_json
from roadgrip.features import road_features
from roadgrip.sections import read_section
from training.__main__ import app
from training.dataset import COMPLETED, Runs, read_description, read_runs, write_runs
from training.scenarios import SHARD_RUNS_COUNT, Design, Road, Shard, runs_of, shards_of
from training.simulation import Progress, drive_design, drive_shard
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.simulator.plan import DriverKind, SensorGrade
from vehicle_client.simulator.run import simulate_passage

pytestmark = [pytest.mark.sim, pytest.mark.xdist_group("sim")]


def small_design(runs_count: int) -> Design:
    return Design(
        name="test",
        roads=(Road(read_section("sharp-turn"), runs_count),),
        base_frictions_mu=(0.3, 0.6),
        sensor_grade=SensorGrade.AUTOMOTIVE,
        driver_kind=DriverKind.PRUDENT,
        seed=11,
    )


@pytest.fixture(scope="module")
def shard() -> Shard:
    """On ice a third of these cars call for their stability system, and one leaves the road."""
    road = Road(read_section("s-turn"), 4)
    return shards_of(replace(small_design(4), roads=(road,), base_frictions_mu=(0.2, 0.6)))[0]


@pytest.fixture(scope="module")
def driven(shard: Shard) -> Runs:
    return drive_shard(shard)


def test_a_shard_gives_one_row_per_run_with_the_friction_its_tyres_found(driven: Runs) -> None:
    assert len(driven) == 8
    base, wear = driven.labels["base_friction_mu"], driven.labels["wear_ratio"]
    assert driven.labels["label_mu"] == pytest.approx(base * wear, rel=1e-6)


def test_a_run_that_is_driven_by_itself_gives_its_row_of_the_shard(shard: Shard, driven: Runs) -> None:
    row = int(np.argmax(driven.labels["esc_active_frac"] * driven.usable))
    run = runs_of(shard)[row]
    drive = simulate_passage(shard.section, run.plan)
    made = summarise_passage(drive.trace, shard.section)
    assert isinstance(made, Summarised)
    assert driven.run_key[row] == run.key
    assert np.array_equal(driven.features[row], [*made.summary.values, *road_features(shard.section)])
    assert {name: values[row] for name, values in driven.labels.items()} == {
        "label_mu": drive.label_mu,
        "base_friction_mu": run.plan.base_friction_mu,
        "wear_ratio": run.plan.wear_factor,
        "esc_active_frac": drive.esc_active_frac,
        "peak_utilisation_ratio": drive.peak_utilisation_ratio,
    }
    assert drive.esc_active_frac > 0.0


def test_completed_runs_have_all_features_and_others_none(driven: Runs) -> None:
    finite = np.isfinite(driven.features[:, :55]).all(axis=1)
    assert finite.tolist() == [outcome == COMPLETED for outcome in driven.outcome]
    assert sorted(set(driven.outcome)) == [COMPLETED, "left_road"]


def test_only_what_this_very_code_has_driven_is_not_driven_again_and_the_result_is_the_same(tmp_path: Path) -> None:
    design = small_design(SHARD_RUNS_COUNT + 1)
    whole = drive_design(design, tmp_path, workers_count=1)
    shard_files = sorted(tmp_path.glob("*.parquet"))
    assert len(shard_files) == 2
    kept_at_ns = shard_files[0].stat().st_mtime_ns
    # The second one as if another version of the simulator had driven it.
    description = {**read_description(shard_files[1]), "code_digest": "0123456789abcdef"}
    write_runs(read_runs(shard_files[1]), shard_files[1], description=description)
    seen: list[Progress] = []
    again = drive_design(design, tmp_path, workers_count=1, on_progress=seen.append)
    assert again.digest() == whole.digest()
    assert shard_files[0].stat().st_mtime_ns == kept_at_ns
    assert seen[0].runs_done_count == 2 * SHARD_RUNS_COUNT
    assert seen[-1].runs_done_count == design.runs_count == 2 * (SHARD_RUNS_COUNT + 1)
    assert read_description(shard_files[0])["seed"] == "11"


@pytest.mark.timeout(400)
def test_the_command_line_goes_from_nothing_to_a_bundle(tmp_path: Path) -> None:
    runner = CliRunner()

    def run(*arguments: object) -> dict[str, object]:
        result = runner.invoke(app, [*map(str, arguments), "--json"])
        assert result.exit_code == 0, result.output
        answer: dict[str, object] = json.loads(result.stdout.strip().splitlines()[-1])
        return answer

    runs, fitted, bundle = tmp_path / "runs", tmp_path / "fit", tmp_path / "bundle"
    simulated = run("simulate", "--section", "sharp-turn", "--runs", 8, "--seed", 3, "--out", runs, "--workers", 1)
    assert simulated["runs_count"] == 88
    assert run("fit", runs, "--out", fitted, "--trees", 20)["rows_count"] == pytest.approx(8, abs=1)
    assert run("export", fitted, "--data", runs, "--out", tmp_path / "model.onnx")["rows_count"] >= 1000  # type: ignore[operator]
    answer = run("bundle", runs, "--fit", fitted, "--out", bundle)
    manifest = manifest_from_json((bundle / "manifest.json").read_text(encoding="utf-8"))
    assert manifest.bundle_id == answer["bundle_id"]
    assert manifest.provenance["dataset_digest"] == simulated["dataset_digest"]


def test_an_unknown_design_is_refused_by_name(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["simulate", "--design", "moon", "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert "moon" in result.output
