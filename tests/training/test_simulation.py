from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from roadgrip.bundle_json import manifest_from_json
from roadgrip.features import road_features
from roadgrip.sections import read_section
from training.cli import app
from training.dataset import COMPLETED, DatasetError, Runs, read_description, read_runs, write_runs
from training.passage_rows import drive_shard
from training.scenarios import Design, Quota, Scenario, Terms, attempted, kept, run_of, surveyed_map
from training.schedule import Block, Shard, runs_of
from training.simulation import Progress, drive_design
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.simulator.plan import DriverKind, SensorGrade
from vehicle_client.simulator.run import simulate_passage

pytestmark = [pytest.mark.sim, pytest.mark.xdist_group("sim")]

AUTOMOTIVE = Terms("test", 11, SensorGrade.AUTOMOTIVE)
SHARP_TURN = Scenario("sharp-turn", read_section("sharp-turn"), attempted(2))
S_TURN = Scenario("s-turn", read_section("s-turn"), attempted(4))

KILLED_WHILE_WRITING = """
import os, signal, sys
from pathlib import Path
import pyarrow.parquet as pq
from tests.training.test_simulation import SHORT_DRIVES
from training import schedule
from training.simulation import drive_design

schedule.FIRST_SHARD_ATTEMPTS_COUNT = 2

written = []
write_table = pq.write_table

def killed_in_the_middle(table, where, **options):
    write_table(table, where, **options)
    written.append(where)
    if len(written) == 2:
        os.truncate(where, os.path.getsize(where) // 2)
        os.kill(os.getpid(), signal.SIGKILL)

pq.write_table = killed_in_the_middle
drive_design(SHORT_DRIVES, Path(sys.argv[1]), workers_count=1)
"""


def design_of(*scenarios: Scenario, terms: Terms = AUTOMOTIVE, frictions_mu: tuple[float, ...] = (0.3, 0.6)) -> Design:
    return Design(terms, scenarios, frictions_mu)


# Five drives that end as soon as they begin to slide.
SHORT_DRIVES = design_of(replace(S_TURN, quota=attempted(5)), frictions_mu=(0.03,))


@pytest.fixture
def small_shards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("training.schedule.FIRST_SHARD_ATTEMPTS_COUNT", 2)


@pytest.fixture(scope="module")
def shard() -> Shard:
    """On ice a third of these cars call for their stability system, and some leave the road."""
    return Shard(AUTOMOTIVE, tuple(Block(i, S_TURN, mu, 0, 4) for i, mu in enumerate((0.2, 0.6))))


@pytest.fixture(scope="module")
def driven(shard: Shard) -> Runs:
    return drive_shard(shard)


def test_a_shard_gives_one_row_per_run_with_the_friction_its_tyres_found(driven: Runs) -> None:
    assert len(driven) == 8
    base, wear = driven.labels["base_friction_mu"], driven.labels["wear_ratio"]
    assert driven.labels["label_mu"] == pytest.approx(base * wear, rel=1e-6)
    assert np.all(driven.labels["lowest_mu"] <= driven.labels["label_mu"] + 1e-12)
    assert driven.labels["attempt_number"].tolist() == [0, 1, 2, 3] * 2


def test_a_run_that_is_driven_by_itself_gives_its_row_of_the_shard(shard: Shard, driven: Runs) -> None:
    row = int(np.argmax((1.0 + driven.labels["esc_active_frac"]) * driven.usable))
    run = [run for block in shard.blocks for run in runs_of(block, shard.terms)][row]
    drive = simulate_passage(S_TURN.section, run.plan)
    made = summarise_passage(drive.trace, surveyed_map(AUTOMOTIVE, S_TURN.section))
    assert isinstance(made, Summarised)
    assert driven.run_key[row] == run.key
    assert np.array_equal(driven.features[row], [*made.summary.values, *road_features(S_TURN.section)])
    labels = {name: values[row] for name, values in driven.labels.items()}
    for name in ("label_mu", "lowest_mu", "abs_active_frac", "tcs_active_frac", "esc_active_frac", "peak_sideslip_rad"):
        assert labels[name] == getattr(drive, name)
    assert labels["friction_guess_mu"] == run.plan.driver.friction_guess_mu
    assert labels["target_speed_mps"] == run.plan.target_speed_mps
    assert labels["duration_s"] == pytest.approx(made.match.exit_s - made.match.entry_s, rel=0.05)
    assert labels["mean_speed_mps"] * labels["duration_s"] == pytest.approx(S_TURN.section.length_m, rel=0.01)


def test_completed_runs_have_all_features_and_others_none(driven: Runs) -> None:
    finite = np.isfinite(driven.features[:, :55]).all(axis=1)
    assert finite.tolist() == [outcome == COMPLETED for outcome in driven.outcome]


def test_ideal_and_automotive_sensors_watch_the_same_drives(shard: Shard, driven: Runs) -> None:
    terms = replace(AUTOMOTIVE, sensor_grade=SensorGrade.IDEAL)
    first, last = 4, 6
    ideal = drive_shard(Shard(terms, (replace(shard.blocks[1], first=0, last=last - first),)))
    assert ideal.run_key == driven.run_key[first:last]
    for name, values in ideal.labels.items():
        assert np.array_equal(values, driven.labels[name][first:last], equal_nan=True), name
    assert ideal.usable.all()
    assert not np.array_equal(ideal.features, driven.features[first:last])


def test_workers_shards_and_batches_change_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    design = design_of(replace(SHARP_TURN, quota=kept(2)), replace(S_TURN, quota=kept(1)))
    monkeypatch.setattr("training.schedule.FIRST_SHARD_ATTEMPTS_COUNT", 4)
    together = drive_design(design, tmp_path / "together", workers_count=2)
    monkeypatch.setattr("training.schedule.FIRST_SHARD_ATTEMPTS_COUNT", 1)
    monkeypatch.setattr("training.passage_rows.BATCH_RUNS_COUNT", 1)
    apart = drive_design(design, tmp_path / "apart", workers_count=1)
    assert len(list((tmp_path / "apart" / "shards").iterdir())) > len(
        list((tmp_path / "together" / "shards").iterdir())
    )
    assert apart.run_key == together.run_key
    assert apart.digest() == together.digest() == read_runs(tmp_path / "apart").digest()


def test_a_cell_ends_with_its_last_wanted_run_and_another_scenario_changes_none_before_it(tmp_path: Path) -> None:
    slippery = replace(S_TURN, quota=kept(2))
    terms = replace(AUTOMOTIVE, driver_kind=DriverKind.REACTING)
    alone = drive_design(design_of(slippery, terms=terms, frictions_mu=(0.35,)), tmp_path / "alone", workers_count=1)
    assert alone.outcome.count(COMPLETED) == 2
    assert alone.outcome[-1] == COMPLETED
    assert len(alone) > 2
    assert alone.labels["attempt_number"].tolist() == list(range(len(alone)))
    both = drive_design(
        design_of(slippery, SHARP_TURN, terms=terms, frictions_mu=(0.35,)), tmp_path / "both", workers_count=1
    )
    assert both.rows(np.arange(len(alone))).digest() == alone.digest()


def test_a_cell_that_nobody_gets_through_ends_at_its_limit_with_every_drive_in_the_table(tmp_path: Path) -> None:
    hopeless = replace(S_TURN, quota=Quota(attempts_limit_count=5, kept_count=2))
    seen: list[Progress] = []
    runs = drive_design(design_of(hopeless, frictions_mu=(0.03,)), tmp_path, workers_count=1, on_progress=seen.append)
    assert len(runs) == 5
    assert COMPLETED not in runs.outcome
    assert (seen[-1].done_count, seen[-1].wanted_count) == (2, 2)
    assert read_description(tmp_path / "runs.parquet")["kept_wanted_count"] == "2"


@pytest.mark.usefixtures("small_shards")
def test_only_what_this_very_code_has_driven_is_not_driven_again_and_the_result_is_the_same(tmp_path: Path) -> None:
    design = SHORT_DRIVES
    whole = drive_design(design, tmp_path, workers_count=1)
    files = sorted((tmp_path / "shards").iterdir())
    assert len(files) == 3
    kept_at_ns = files[0].stat().st_mtime_ns
    # The second one as if another version of the simulator had driven it.
    description = {**read_description(files[1]), "code_digest": "0123456789abcdef"}
    write_runs(read_runs(files[1]), files[1], description=description)
    seen: list[Progress] = []
    again = drive_design(design, tmp_path, workers_count=1, on_progress=seen.append)
    assert again.digest() == whole.digest()
    assert files[0].stat().st_mtime_ns == kept_at_ns
    assert 0 < seen[-1].driven_now_count < seen[-1].attempts_count == len(whole)
    drive_design(design, tmp_path, workers_count=1, on_progress=seen.append)
    assert seen[-1].driven_now_count == 0


def test_a_file_that_a_power_failure_cut_short_is_driven_again(tmp_path: Path) -> None:
    design = design_of(SHARP_TURN, frictions_mu=(0.5,))
    whole = drive_design(design, tmp_path, workers_count=1)
    for path in (tmp_path / "runs.parquet", *(tmp_path / "shards").iterdir()):
        os.truncate(path, path.stat().st_size // 2)
    assert drive_design(design, tmp_path, workers_count=1).digest() == whole.digest()
    assert read_runs(tmp_path).digest() == whole.digest()


@pytest.mark.usefixtures("small_shards")
@pytest.mark.system
def test_killed_in_the_middle_of_a_file_it_goes_on_and_gives_what_was_to_be_given(
    tmp_path: Path, project_root: Path
) -> None:
    whole = drive_design(SHORT_DRIVES, tmp_path / "whole", workers_count=1)
    folder = tmp_path / "killed"
    script = subprocess.run([sys.executable, "-c", KILLED_WHILE_WRITING, str(folder)], cwd=project_root, check=False)
    assert script.returncode == -signal.SIGKILL
    assert sorted(path.suffix for path in (folder / "shards").iterdir()) == [".parquet", ".partial"]
    with pytest.raises(DatasetError, match="not finished"):
        read_runs(folder)
    seen: list[Progress] = []
    resumed = drive_design(SHORT_DRIVES, folder, workers_count=1, on_progress=seen.append)
    assert resumed.digest() == whole.digest()
    assert 0 < seen[-1].driven_now_count < len(whole)


@pytest.mark.long
@pytest.mark.system
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="finds child processes through /proc")
def test_workers_do_not_outlive_a_command_that_is_killed(tmp_path: Path, project_root: Path) -> None:
    words = f"simulate --section sharp-turn --runs 100 --workers 2 --out {tmp_path}".split()
    command = subprocess.Popen([sys.executable, "-m", "training", *words], cwd=project_root, stderr=subprocess.DEVNULL)

    def children() -> list[int]:
        path = Path(f"/proc/{command.pid}/task/{command.pid}/children")
        return [int(pid) for pid in path.read_text(encoding="utf-8").split()]

    def wait_until(condition: object) -> None:
        deadline = time.monotonic() + 60.0
        while not condition():  # type: ignore[operator]
            assert time.monotonic() < deadline
            time.sleep(0.05)

    wait_until(lambda: any((tmp_path / "shards").glob("*.parquet")))
    workers = children()
    command.kill()
    command.wait()
    assert len(workers) >= 2
    wait_until(lambda: not any(_runs(pid) for pid in workers))


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        # One that has ended and waits for somebody to ask does not count.
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    except (ProcessLookupError, FileNotFoundError):
        return False


def test_full_histories_are_kept_where_they_are_asked_for(tmp_path: Path) -> None:
    design = design_of(SHARP_TURN, frictions_mu=(0.5,))
    runs = drive_design(design, tmp_path, workers_count=1)
    assert not (tmp_path / "drives").exists()
    seen: list[Progress] = []
    drive_design(design, tmp_path, workers_count=1, with_drives=True, on_progress=seen.append)
    assert seen[-1].driven_now_count == 2
    (path,) = (tmp_path / "drives").iterdir()
    table = pq.read_table(path)
    assert tuple(dict.fromkeys(table["run_key"].to_pylist())) == runs.run_key
    drive = simulate_passage(SHARP_TURN.section, run_of(AUTOMOTIVE, SHARP_TURN, base_friction_mu=0.5, number=0).plan)
    rows = np.flatnonzero(np.array(table["run_key"].to_pylist()) == runs.run_key[0])
    for name, values in (("yaw_rate_radps", drive.trace.yaw_rate_radps), ("true_station_m", drive.truth.station_m)):
        assert np.array_equal(table[name].to_numpy()[rows], values.astype(np.float32))


@pytest.mark.timeout(400)
def test_the_command_line_goes_from_nothing_to_a_bundle(tmp_path: Path) -> None:
    runner = CliRunner()

    def run(*arguments: object) -> dict[str, object]:
        result = runner.invoke(app, [*map(str, arguments), "--json"])
        assert result.exit_code == 0, result.output
        answer: dict[str, object] = json.loads(result.stdout.strip().splitlines()[-1])
        return answer

    runs, fitted, bundle, cells = (tmp_path / name for name in ("runs", "fit", "bundle", "cells.json"))
    simulated = run(
        "simulate", "--section", "sharp-turn", "--runs", 8, "--seed", 3, "--out", runs, "--workers", 1, "--cells", cells
    )
    assert simulated["runs_count"] == 88
    (told,) = json.loads(cells.read_text(encoding="utf-8"))["designs"]
    assert (told["seed"], told["dataset_digest"]) == (3, simulated["dataset_digest"])
    assert told["command"] == (
        "roadgrip-train simulate --section sharp-turn --sensors automotive --driver prudent --runs 8 --seed 3"
    )
    again = run("cells", runs, "--plot", tmp_path / "cells.svg")
    assert again["designs"] == [told]
    assert (tmp_path / "cells.svg").exists()
    assert run("fit", runs, "--out", fitted, "--trees", 20)["rows_count"] == pytest.approx(8, abs=1)
    assert run("export", fitted, "--data", runs, "--out", tmp_path / "model.onnx")["rows_count"] >= 1000  # type: ignore[operator]
    answer = run("bundle", runs, "--fit", fitted, "--out", bundle)
    manifest = manifest_from_json((bundle / "manifest.json").read_text(encoding="utf-8"))
    assert manifest.bundle_id == answer["bundle_id"]
    assert manifest.provenance["dataset_digest"] == simulated["dataset_digest"]
