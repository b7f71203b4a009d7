"""The command `roadgrip-train tune-observer`: what it writes, what it warns of, what it refuses."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.training.gripping_drives import gripping_recording, reference_csv
from training.cli import app, run
from training.cli_tune import DEFAULT_BASE_FRICTIONS_MU
from vehicle_client.estimation.observer import XC90_PARAMETERS
from vehicle_client.vehicle_profile import PAPER_VEHICLE, profile_of_toml, toml_of_profile

HALF = XC90_PARAMETERS.rear_slip_gradient_s2pm / 2.0
QUICK = ("--constant", "rear_slip_gradient_s2pm", "--evaluations", "40")


@pytest.fixture(scope="module")
def drive_csv() -> bytes:
    return reference_csv(gripping_recording(slip_gradient_s2pm=HALF))


@pytest.fixture
def inside(tmp_path, monkeypatch, drive_csv):
    """A folder with a recording in it, and the current one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive.csv").write_bytes(drive_csv)
    return tmp_path


def _invoke(*arguments: str):
    return CliRunner().invoke(app, ["tune-observer", *arguments])


def test_a_vehicle_file_is_written_with_the_tuned_constants(inside):
    result = _invoke("--recording", "drive.csv", *QUICK, "--out", "new/car.toml", "--plot", "new/car.svg")
    assert result.exit_code == 0, result.output
    profile = profile_of_toml((inside / "new/car.toml").read_text(encoding="utf-8"), place="car.toml")
    assert profile.geometry == PAPER_VEHICLE.geometry
    assert profile.parameters.rear_slip_gradient_s2pm == pytest.approx(HALF, rel=0.05)
    assert "held out" in result.output
    assert (inside / "new/car.svg").read_text(encoding="utf-8").startswith("<?xml")


def test_it_starts_from_a_vehicle_file_and_keeps_the_rest_of_it(inside):
    text = toml_of_profile(PAPER_VEHICLE).replace("Volvo XC90 2015", "Ours").replace("2.984", "2.9")
    (inside / "car.toml").write_text(text, encoding="utf-8")
    result = _invoke("--recording", "drive.csv", "--vehicle", "car.toml", *QUICK, "--out", "tuned.toml")
    assert result.exit_code == 0, result.output
    profile = profile_of_toml((inside / "tuned.toml").read_text(encoding="utf-8"), place="tuned.toml")
    assert profile.name == "Ours"
    assert profile.geometry.wheelbase_m == pytest.approx(2.9)


def test_machines_get_json(inside):
    first, again = (_invoke("--recording", "drive.csv", *QUICK, "--json") for _ in range(2))
    document = json.loads(first.stdout)
    assert document == json.loads(again.stdout)
    assert document["improved"] is True
    assert document["held_out"]["after"]["rms_rad"] < document["held_out"]["before"]["rms_rad"]
    assert set(document["constants"]) == {"rear_slip_gradient_s2pm"}


@pytest.mark.parametrize(("options", "kept"), [((), True), (("--accept-worse",), False)])
def test_what_does_not_help_where_it_was_not_tuned_is_said_and_not_kept(inside, options, kept):
    # The second half is another car, of which the first tells the wrong way.
    parts = [gripping_recording(slip_gradient_s2pm=g) for g in (HALF, 4.0 * HALF)]
    velocity_y = np.concatenate(
        [parts[0].reference["velocity_y_mps"][:3000], parts[1].reference["velocity_y_mps"][3000:]]
    )
    accel_y = np.concatenate([parts[0].trace.accel_y_mps2[:3000], parts[1].trace.accel_y_mps2[3000:]])
    (inside / "two.csv").write_bytes(reference_csv(parts[0], reference_velocity_y_mps=velocity_y, accel_y_mps2=accel_y))
    result = _invoke("--recording", "two.csv", *QUICK, "--out", "car.toml", *options)
    assert result.exit_code == 0, result.output
    assert "did not become better" in result.output
    profile = profile_of_toml((inside / "car.toml").read_text(encoding="utf-8"), place="car.toml")
    assert (profile.parameters == XC90_PARAMETERS) is kept


@pytest.mark.parametrize(
    ("arguments", "needle"),
    [
        (["--recording", "nowhere.csv"], "cannot use nowhere.csv: No such file"),
        (["--recording", "bare.csv"], "bare.csv: no column reference_velocity_y_mps"),
        (["--recording", "drive.csv", "--format", "ferrari-250lm"], "drive.csv: no column"),
        (["--recording", "drive.csv", "--vehicle", "drive.csv"], "drive.csv is no TOML"),
        (["--recording", "drive.csv", "--held-out", "0.8"], "too short to judge"),
        (["--simulate", "2", "--section", "nowhere"], "nowhere"),
    ],
)
def test_what_cannot_be_is_one_line_and_exit_code_2(inside, arguments, needle, monkeypatch, capsys):
    whole = (inside / "drive.csv").read_bytes()
    (inside / "bare.csv").write_bytes(whole.replace(b"reference_velocity_y", b"told_velocity_y", 1))
    monkeypatch.setattr("sys.argv", ["roadgrip-train", "tune-observer", *arguments])
    with pytest.raises(SystemExit) as left:
        run()
    assert left.value.code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert needle in lines[-1]
    assert lines[-1].startswith("error: ")


@pytest.mark.parametrize(
    ("arguments", "needle"),
    [
        ([], "give recordings, or how many drives"),
        (["--recording", "drive.csv", "--simulate", "2"], "give recordings, or how many drives"),
        (["--recording", "drive.csv", "--format", "lada"], "lada"),
        (["--recording", "drive.csv", "--constant", "lowpass"], "no constant lowpass; there are alpha_0_1ps"),
        (["--recording", "drive.csv", "--plot", "car.txt"], "must end in one of .svg"),
    ],
)
def test_what_contradicts_itself_is_refused_by_name(inside, arguments, needle):
    result = _invoke(*arguments, "--out", "car.toml")
    assert result.exit_code == 2
    assert needle in " ".join(result.output.replace("│", " ").split())
    assert not (inside / "car.toml").exists()


@pytest.mark.sim
def test_simulated_drives_are_tuned_on_and_judged_on_others(inside):
    result = _invoke("--simulate", "2", "--section", "s-turn", "--base-friction", "0.8", "--evaluations", "4", "--json")
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert document["tuned"]["before"]["judged_s"] > 5.0
    assert document["held_out"]["before"]["judged_s"] > 5.0
    assert document["evaluations_count"] <= 4


@pytest.mark.sim
def test_a_road_too_slippery_to_drive_is_said(inside, monkeypatch, capsys):
    options = ["--simulate", "2", "--section", "s-turn", "--base-friction", "0.05"]
    monkeypatch.setattr("sys.argv", ["roadgrip-train", "tune-observer", *options])
    with pytest.raises(SystemExit) as left:
        run()
    assert left.value.code == 2
    assert "ask for more grip" in capsys.readouterr().err
    assert DEFAULT_BASE_FRICTIONS_MU[0] > 0.05
