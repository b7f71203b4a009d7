"""`roadgrip-vehicle memory`, and drives of one car replayed one after the other."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from roadgrip.errors import ConfigurationError
from roadgrip.features import PAPER_TABLE
from roadgrip.section_file import section_to_json
from roadgrip.sections import read_section
from tests.vehicle_client.synthetic import drive_over, road, s_turn, with_noise
from vehicle_client.cli import app_of
from vehicle_client.estimation.grip.memory import CONSTANTS, new_memory
from vehicle_client.shell.car_memory import first_memory, keep_memory, memory_of
from vehicle_client.shell.memory_view import WORDS
from vehicle_client.shell.sources import write_trace_csv
from vehicle_client.vehicle_profile import PAPER_VEHICLE, scaled_to, toml_of_profile

APP = app_of()
NEW = first_memory(PAPER_VEHICLE)
TAUGHT = replace(NEW, mean=(0.002, *NEW.mean[1:6], 0.05, *NEW.mean[7:]), passages_count=7)


def run(*arguments) -> tuple[int, str]:
    result = CliRunner().invoke(APP, [str(a) for a in arguments], env={"COLUMNS": "160"})
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout


@pytest.fixture
def memory_file(tmp_path):
    keep_memory(tmp_path / "memory.json", TAUGHT, PAPER_VEHICLE)
    return tmp_path / "memory.json"


@pytest.fixture
def vehicle_file(tmp_path):
    path = tmp_path / "vehicle.toml"
    path.write_text(toml_of_profile(PAPER_VEHICLE), encoding="utf-8")
    return path


def test_every_constant_has_its_words():
    assert set(WORDS) == {constant.name for constant in CONSTANTS}


def test_a_memory_is_told_in_words(memory_file, vehicle_file):
    code, out = run("memory", memory_file)
    assert code == 0
    assert "passages learned from: 7" in out
    (steering,) = [line for line in out.splitlines() if WORDS["steer_offset_rad"] in line]
    assert "0 ± 1.00 mrad" in steering
    assert "+2.00 mrad ± 1.00 mrad" in steering
    (stiffness,) = [line for line in out.splitlines() if WORDS["stiffness_log_ratio"] in line]
    assert "as in its file ± 10.0 %" in stiffness
    assert "+5.1 % ± 10.0 %" in stiffness
    code, out = run("memory", memory_file, "--vehicle", vehicle_file)
    assert f"{PAPER_VEHICLE.handling.tyre.stiffness_ratio:.4g}" in out


def test_a_memory_is_told_to_a_machine(memory_file, vehicle_file):
    told = json.loads(run("memory", memory_file, "--json")[1])
    assert told["passages_count"] == 7
    assert told["constants"]["steer_offset_rad"] == {"value": 0.002, "std": 0.001, "declared_std": 0.001}
    told = json.loads(run("memory", memory_file, "--json", "--vehicle", vehicle_file)[1])
    tyre = told["constants"]["stiffness_log_ratio"]["handling"]["tyre.stiffness_ratio"]
    assert tyre["learned"] == pytest.approx(np.exp(0.05) * tyre["declared"])


def test_a_memory_is_forgotten(memory_file):
    code, out = run("memory", memory_file, "--forget")
    assert code == 0
    assert "forgotten" in out
    assert not memory_file.exists()
    with pytest.raises(ConfigurationError, match="learned nothing yet"):
        run("memory", memory_file)


@pytest.mark.parametrize("more", [[], ["--forget"]])
def test_what_is_no_memory_and_that_of_another_car_are_refused_and_left(tmp_path, memory_file, more):
    other = tmp_path / "other.toml"
    other.write_text(toml_of_profile(replace(PAPER_VEHICLE, name="van", handling=scaled_to(3000.0))), encoding="utf-8")
    with pytest.raises(ConfigurationError, match="'van'"):
        run("memory", memory_file, "--vehicle", other, *more)
    assert memory_file.exists()
    with pytest.raises(ConfigurationError, match="no memory"):
        run("memory", other, *more)
    assert other.exists()


# Replayed ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives")
    (folder / "road.json").write_text(section_to_json(road(s_turn)), encoding="utf-8")
    trace, _ = drive_over(s_turn)
    for number in range(3):
        write_trace_csv(folder / f"drive{number}.csv", with_noise(trace, np.random.default_rng(number)))
    return folder


def replayed(folder, numbers, *more):
    drives = [folder / f"drive{number}.csv" for number in numbers]
    code, out = run("replay", *drives, "--section", folder / "road.json", "--dry-run", "--json", *more)
    assert code == 0
    return json.loads(out)


def test_a_car_that_is_replayed_remembers_from_drive_to_drive_in_one_command_or_several(recordings, tmp_path):
    at_once, apart = tmp_path / "at-once.json", tmp_path / "apart.json"
    together = replayed(recordings, range(3), "--memory", at_once)
    assert [told["memory"]["passages_count"] for told in together] == [1, 2, 3]
    one_by_one = [replayed(recordings, [number], "--memory", apart) for number in range(3)]
    assert one_by_one == together
    assert at_once.read_bytes() == apart.read_bytes()


def test_without_a_memory_nothing_is_learned_and_nothing_changes(recordings, tmp_path):
    without = replayed(recordings, range(3))
    again = [replayed(recordings, [number]) for number in range(3)]
    assert without == again
    assert "memory" not in without[0]
    with_memory = replayed(recordings, range(3), "--memory", tmp_path / "memory.json")
    for plain, remembering in zip(without, with_memory, strict=True):
        changed = {
            name
            for name, value in plain["passage"]["values"].items()
            if value != remembering["passage"]["values"][name]
        }
        assert changed
        assert changed.isdisjoint(feature.name for feature in PAPER_TABLE.kinematic)


def test_a_replay_says_to_a_person_how_much_was_learned(recordings, tmp_path):
    path = tmp_path / "memory.json"
    _, out = run("replay", recordings / "drive0.csv", "-s", recordings / "road.json", "--dry-run", "--memory", path)
    (told,) = [line for line in out.splitlines() if "passages learned from" in line]
    assert told.split()[-2] == "1"


def test_a_memory_that_cannot_be_used_is_refused_and_left(recordings, tmp_path):
    path = tmp_path / "memory.json"
    for spoil, needle in (
        (lambda: path.write_text("{}", encoding="utf-8"), "no memory"),
        (lambda: keep_memory(path, new_memory(handling_std_ratio=0.01), PAPER_VEHICLE), "declared otherwise"),
    ):
        spoil()
        before = path.read_bytes()
        with pytest.raises(ConfigurationError, match=needle):
            replayed(recordings, [0], "--memory", path)
        assert path.read_bytes() == before
    with pytest.raises(ConfigurationError, match="cannot write"):
        replayed(recordings, [0], "--memory", tmp_path / "nowhere" / "memory.json")


@pytest.mark.sim
def test_a_simulated_car_finds_what_its_sensors_get_wrong(tmp_path):
    from vehicle_client.simulator.plan import SensorGrade, draw_plan
    from vehicle_client.simulator.run import simulate_passages

    first, errors = NEW.first_std, []
    for sensor_seed in (51, 52):
        path, rng, driven = tmp_path / f"{sensor_seed}.json", np.random.default_rng(4), []
        for name in ("long-turn", "s-turn", "sharp-turn"):
            section = read_section(name)
            plans = [
                draw_plan(rng, section=section, base_friction_mu=mu, grade=SensorGrade.AUTOMOTIVE, with_gnss=True)
                for mu in (0.45, 0.6, 0.75, 0.85)
            ]
            plans = [replace(plan, sensor_seed=sensor_seed) for plan in plans]
            drives = [drive for drive in simulate_passages(section, plans) if drive.completed]
            files = [tmp_path / f"{sensor_seed}-{name}-{number}.csv" for number in range(len(drives))]
            for file, drive in zip(files, drives, strict=True):
                write_trace_csv(file, drive.trace)
            run("replay", *files, "-s", name, "--dry-run", "--json", "--memory", path)
            driven += drives
        memory = memory_of(path, PAPER_VEHICLE)
        assert memory.passages_count > 8
        steer_rad, accel_mps2 = (
            float(np.mean([np.mean(getattr(d.trace, name) - getattr(d.truth, name)) for d in driven]))
            for name in ("steer_rad", "accel_y_mps2")
        )
        assert memory.value("steer_offset_rad") == pytest.approx(steer_rad, abs=0.4 * first[0])
        assert memory.std("steer_offset_rad") < 0.3 * first[0]
        assert memory.std("accel_y_offset_mps2") < 0.3 * first[2]
        errors.append((accel_mps2, memory.value("accel_y_offset_mps2")))
    # Beside its error an accelerometer feels lean and bank, which are those of the same drives in both cars.
    (one, told_one), (other, told_other) = errors
    assert abs(one - other) > 0.01
    assert told_one - told_other == pytest.approx(one - other, abs=0.35 * first[2])
