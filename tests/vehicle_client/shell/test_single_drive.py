"""One drive: what is ordered, what is said of it, what is drawn."""

from __future__ import annotations

import builtins
import json
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from roadgrip.errors import ConfigurationError
from roadgrip.records import Reason, Rejected
from roadgrip.section import RoadSection
from roadgrip.sections import read_section
from roadgrip.units import GRAVITY_MPS2
from tests.vehicle_client.shell.cars import a_drive
from vehicle_client.cli import app_of
from vehicle_client.estimation.grip.noise import AUTOMOTIVE_NOISE, IDEAL_NOISE
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.shell.drive_picture import (
    axle_force_ratio,
    axle_slip_rad,
    draw_drive,
    drive_figure,
    motion_panels,
    moving_mean,
    stretches,
    tyre_force_ratio,
)
from vehicle_client.shell.single_drive import (
    DriveOrder,
    Evenness,
    SingleDrive,
    StabilitySystem,
    activities_of,
    drive_once,
    outcome_text,
    plan_of,
    single_drive_to_json,
)
from vehicle_client.simulator.drive import DriveOutcome, Truth
from vehicle_client.simulator.plan import DriverKind, PassagePlan, RoughnessClass, SensorGrade
from vehicle_client.simulator.vehicle import XC90

SLIPPERY = DriveOrder(base_friction_mu=0.15, kind=DriverKind.REACTING, speed_mps=23.0)
"""More than a driver who goes by feeling alone gets through the S-turn with."""


@pytest.fixture(scope="module")
def s_turn() -> RoadSection:
    return read_section("s-turn")


@pytest.fixture(scope="module")
def completed(s_turn: RoadSection) -> SingleDrive:
    return drive_once(s_turn, DriveOrder(base_friction_mu=0.8, second_friction_mu=0.6, wear_factor=0.9, speed_mps=13.0))


@pytest.fixture(scope="module")
def failed(s_turn: RoadSection) -> SingleDrive:
    return drive_once(s_turn, SLIPPERY)


def a_truth(**signals: np.ndarray) -> Truth:
    return replace(a_drive(read_section("s-turn"), PassagePlan(base_friction_mu=0.5, seed=1)).truth, **signals)


def test_what_is_ordered_is_planned(s_turn: RoadSection):
    plan = plan_of(
        s_turn,
        DriveOrder(
            speed_mps=12.0,
            wear_factor=0.85,
            pressure_pa=200_000.0,
            kind=DriverKind.REACTING,
            evenness=Evenness.C,
            without=frozenset({StabilitySystem.ABS, StabilitySystem.ESC}),
        ),
    )
    assert (plan.target_speed_mps, plan.wear_factor, plan.pressure_pa) == (12.0, 0.85, 200_000.0)
    assert math.isinf(plan.driver.friction_guess_mu)
    assert plan.roughness is RoughnessClass.C
    assert plan.stability == (False, True, False)


def test_what_is_ordered_leaves_the_other_draws_alone(s_turn: RoadSection):
    drawn = plan_of(s_turn, DriveOrder())
    asked = plan_of(s_turn, DriveOrder(speed_mps=12.0, wear_factor=0.85, evenness=Evenness.SMOOTH))
    assert (asked.driver, asked.seed) == (drawn.driver, drawn.seed)
    assert asked.roughness is None
    assert replace(drawn, target_speed_mps=12.0, wear_factor=0.85, roughness=None) == asked


def test_a_second_friction_begins_in_the_middle(s_turn: RoadSection):
    profile = plan_of(s_turn, DriveOrder(base_friction_mu=0.5, second_friction_mu=0.3)).friction_profile
    assert profile is not None
    at_m = np.array([0.0, 0.5 * s_turn.length_m, s_turn.length_m])
    assert np.interp(at_m, profile.station_m, profile.left_mu) == pytest.approx([0.5, 0.4, 0.3])
    assert np.array_equal(profile.left_mu, profile.right_mu)


def test_every_class_of_roughness_can_be_ordered():
    assert [evenness.roughness for evenness in Evenness] == [None, *RoughnessClass]


@pytest.mark.parametrize("outcome", list(DriveOutcome))
def test_every_outcome_has_words(s_turn: RoadSection, outcome: DriveOutcome):
    plan = PassagePlan(base_friction_mu=0.5, seed=1)
    driven = SingleDrive(a_drive(s_turn, plan, outcome=outcome), Rejected(Reason.PASSAGE_ABORTED, ""))
    assert (outcome_text(driven) == "completed") is driven.drive.completed


def test_a_single_intervention_does_not_read_as_none(s_turn: RoadSection):
    plan = plan_of(s_turn, DriveOrder(without=frozenset({StabilitySystem.TCS})))
    drive = replace(a_drive(s_turn, plan), abs_active_frac=0.002, esc_active_frac=0.25)
    assert [activity.text for activity in activities_of(drive)] == ["0.2%", "off", "25%"]


@given(yaw_rate_radps=st.floats(-0.8, 0.8), speed_mps=st.floats(3.0, 40.0), slide_rad=st.floats(-0.3, 0.3))
def test_wheels_that_roll_where_they_point_have_no_slip(yaw_rate_radps: float, speed_mps: float, slide_rad: float):
    # The car turns about a point abreast of the rear axle; then the body is turned by an angle under its velocity.
    rear_left_mps = speed_mps * math.tan(-slide_rad)
    ahead_left_mps = rear_left_mps + XC90.wheelbase_m * yaw_rate_radps
    truth = a_truth(
        velocity_x_mps=np.array([speed_mps]),
        velocity_y_mps=np.array([rear_left_mps + XC90.rear_axle_m * yaw_rate_radps]),
        yaw_rate_radps=np.array([yaw_rate_radps]),
        steer_rad=np.array([math.atan2(ahead_left_mps, speed_mps) + slide_rad]),
    )
    front_rad, rear_rad = axle_slip_rad(truth, XC90)
    assert front_rad == pytest.approx(slide_rad, abs=1e-9)
    assert rear_rad == pytest.approx(slide_rad, abs=1e-9)


def test_forces_of_a_turned_front_axle_are_taken_along_the_car():
    quarter_n = XC90.mass_kg * GRAVITY_MPS2 / 4.0
    truth = a_truth(
        steer_rad=np.array([math.pi / 6.0]),
        wheel_force_x_n=np.zeros((1, 4)),
        wheel_force_y_n=quarter_n * np.array([[0.2, 0.4, 0.3, 0.3]]),
        wheel_load_n=np.full((1, 4), quarter_n),
    )
    forward, left = tyre_force_ratio(truth, XC90)
    assert forward == pytest.approx(-0.15 * 0.5)
    assert left == pytest.approx(0.15 * math.cos(math.pi / 6.0) + 0.15)
    front, rear = axle_force_ratio(truth)
    assert (float(front[0]), float(rear[0])) == pytest.approx((0.3, 0.3))


@given(active=st.lists(st.booleans(), max_size=40))
def test_stretches_are_the_samples_at_work(active: list[bool]):
    pieces = stretches(np.array(active, dtype=np.bool_))
    assert [i for a, b in pieces for i in range(a, b)] == [i for i, on in enumerate(active) if on]
    assert all(a < b for a, b in pieces)
    assert all(one[1] < two[0] for one, two in pairwise(pieces))


@given(count=st.integers(1, 100), value=st.floats(-1e3, 1e3))
def test_the_mean_of_what_does_not_change_is_itself(count: int, value: float):
    assert moving_mean(np.full(count, value)) == pytest.approx(np.full(count, value), abs=1e-9)


@pytest.mark.sim
def test_the_json_of_a_drive_says_what_was_driven(completed: SingleDrive):
    found = json.loads(json.dumps(single_drive_to_json(completed)))
    assert found["outcome"] == "completed"
    assert found["friction_mu"] == pytest.approx(0.54)
    assert found["lowest_friction_mu"] <= found["friction_mu"] + 1e-9
    assert found["slowest_mps"] < found["fastest_mps"]
    assert (found["roughness_class"], found["second_friction_mu"]) == ("a", 0.6)
    assert 0.0 <= found["esc_active_frac"] <= 1.0


@pytest.mark.sim
def test_what_is_drawn_of_the_tyres_is_what_the_drive_says(completed: SingleDrive):
    truth = completed.drive.truth
    front, rear = axle_force_ratio(truth)
    steady = (truth.station_m < 250.0) | (truth.station_m > 350.0)
    # Apart from the changeover both axles find the same friction.
    assert (np.maximum(front, rear) / truth.friction_mu)[steady] == pytest.approx(truth.utilisation_ratio[steady])
    _, left = tyre_force_ratio(truth, completed.drive.plan.vehicle)
    felt = truth.accel_y_mps2 / GRAVITY_MPS2 + np.sin(truth.bank_rad)
    assert left == pytest.approx(felt, abs=0.05)


@pytest.mark.sim
def test_a_picture_holds_truth_and_estimate(completed: SingleDrive, s_turn: RoadSection):
    pytest.importorskip("matplotlib")
    figure = drive_figure(completed, s_turn)
    panels = {axes.get_title(loc="left"): axes for axes in figure.get_axes()}
    for title in ("speed, km/h", "yaw rate excess, degrees/s", "sideslip, degrees"):
        _, names = panels[title].get_legend_handles_labels()
        assert names == ["true", "estimated on board"]
    assert len(panels["wheel loads, kN"].get_lines()) == 4
    # Two frictions, two circles.
    circles: list[Any] = list(panels["force of the tyres over the car's weight"].patches)
    assert sorted(circle.get_radius() for circle in circles) == pytest.approx([0.54, 0.72])
    assert "completed" in figure.get_suptitle()


@pytest.mark.sim
def test_a_drive_that_failed_is_drawn_up_to_its_end(failed: SingleDrive, s_turn: RoadSection):
    pytest.importorskip("matplotlib")
    assert not failed.drive.completed
    assert all([line.name for line in panel.lines] == [""] for panel in motion_panels(failed))
    figure = drive_figure(failed, s_turn)
    said = outcome_text(failed)
    assert said in figure.get_suptitle()
    assert "no summary" in figure.get_suptitle()
    path, speed = (
        next(axes for axes in figure.get_axes() if axes.get_title(loc="left").startswith(word))
        for word in ("path", "speed")
    )
    assert said in [text.get_text() for text in path.texts]
    ended_at_m = failed.drive.truth.station_m[-1]
    assert ended_at_m < speed.get_xlim()[1] < s_turn.length_m


@pytest.mark.sim
@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_a_picture_is_written_as_its_name_asks(failed: SingleDrive, s_turn: RoadSection, suffix: str, tmp_path: Path):
    pytest.importorskip("matplotlib")
    path = tmp_path / f"drive{suffix}"
    draw_drive(failed, s_turn, path)
    start = {".png": b"\x89PNG", ".svg": b"<?xml"}[suffix]
    assert path.read_bytes().startswith(start)


@pytest.mark.sim
def test_a_picture_that_cannot_be_written_is_said(failed: SingleDrive, s_turn: RoadSection, tmp_path: Path):
    pytest.importorskip("matplotlib")
    for path in (tmp_path / "no" / "folder.png", tmp_path / "drive.nothing", tmp_path):
        with pytest.raises(ConfigurationError, match="cannot draw into"):
            draw_drive(failed, s_turn, path)


@pytest.mark.sim
def test_without_matplotlib_one_is_told_how_to_get_it(
    failed: SingleDrive, s_turn: RoadSection, monkeypatch: pytest.MonkeyPatch
):
    real = builtins.__import__

    def without(name: str, *arguments: Any, **named: Any) -> Any:
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *arguments, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ConfigurationError, match="pip install"):
        drive_figure(failed, s_turn)


@pytest.mark.sim
def test_what_the_simulator_cannot_drive_is_a_configuration_that_cannot_be(s_turn: RoadSection):
    with pytest.raises(ConfigurationError, match="bar"):
        drive_once(s_turn, DriveOrder(pressure_pa=50_000.0))


@pytest.mark.sim
def test_more_roughness_shakes_the_wheels_more(s_turn: RoadSection):
    least_n = [
        single_drive_to_json(drive_once(s_turn, DriveOrder(base_friction_mu=0.8, evenness=evenness)))[
            "least_wheel_load_n"
        ]
        for evenness in (Evenness.SMOOTH, Evenness.A, Evenness.C)
    ]
    assert least_n == sorted(least_n, reverse=True)


@pytest.mark.sim
def test_the_command_takes_what_can_be_ordered(tmp_path: Path):
    options = "-s sharp-turn --driver reacting --speed 18 --wear 0.9 --pressure 2.2 --roughness smooth --json"
    systems = "--without esc --without tcs --second-friction 0.6 --sensors ideal --trace"
    result = CliRunner().invoke(app_of(), ["drive", *options.split(), *systems.split(), str(tmp_path / "drive.csv")])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["target_speed_mps"] == pytest.approx(5.0)
    assert (found["wear_factor"], found["pressure_pa"], found["second_friction_mu"]) == (
        0.9,
        pytest.approx(220_000.0),
        0.6,
    )
    assert (found["abs_on"], found["tcs_on"], found["esc_on"]) == (True, False, False)
    assert found["roughness_class"] is None
    assert found["driver_guess_mu"] is None
    assert (found["tcs_active_frac"], found["esc_active_frac"]) == (0.0, 0.0)


@pytest.mark.parametrize(
    "options",
    ["--roughness z", "--without brakes", "--pressure 9", "--wear nan", "--speed 0", "--second-friction 3"],
)
def test_an_option_out_of_its_range_is_refused(options: str):
    result = CliRunner().invoke(app_of(), ["drive", *options.split()])
    assert result.exit_code == 2
    assert options.split(maxsplit=1)[0] in result.output


@pytest.mark.sim
def test_the_car_declares_the_sensors_it_carries(s_turn):
    driven = drive_once(s_turn, DriveOrder(grade=SensorGrade.IDEAL))
    assert isinstance(driven.made, Summarised)
    declared, undeclared = (
        summarise_passage(driven.drive.trace, s_turn, noise=n) for n in (IDEAL_NOISE, AUTOMOTIVE_NOISE)
    )
    assert isinstance(declared, Summarised)
    assert isinstance(undeclared, Summarised)
    assert driven.made.summary == declared.summary != undeclared.summary
