"""A constant that is declared a tenth too large: how far it shifts the best friction, as docs/vehicle.md tells it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.vehicle_client.estimation.grip.two_axles import HANDLING, driven, told_of, winding
from vehicle_client.estimation.handling import Handling

FRICTIONS_MU = (0.2, 0.4, 0.7)
USES_RATIO = (0.4, 0.7, 0.9)
CASES = [(friction_mu, use_ratio) for use_ratio in USES_RATIO for friction_mu in FRICTIONS_MU]
TOLD = 0.01
"""The page tells whole per cent."""


def more(*names: str, tyre: tuple[str, ...] = ()) -> Handling:
    """Return the handling with some constants a tenth larger."""
    larger = {name: 1.1 * getattr(HANDLING.tyre, name) for name in tyre}
    body = {name: 1.1 * getattr(HANDLING, name) for name in names}
    return replace(HANDLING, **body, tyre=replace(HANDLING.tyre, **larger))


DECLARED = {
    "slip of the peak": more(tyre=("peak_slip_ratio", "peak_slip_twice_ratio")),
    "stiffness, at both loads": more(tyre=("stiffness_ratio", "stiffness_twice_ratio")),
    "nominal load alone": more(tyre=("nominal_load_n",)),
    "mass alone": more("mass_kg"),
    "mass and nominal load": more("mass_kg", "yaw_inertia_kgm2", tyre=("nominal_load_n",)),
    "yaw inertia": more("yaw_inertia_kgm2"),
    "share of the drive on the front axle": more("front_drive_frac"),
    "compliance of the steering (from none to a tenth of the XC90's)": replace(
        HANDLING, steer_compliance_radpn=0.16e-6
    ),
    "load shift of both axles": more("front_transfer_height_m", "rear_transfer_height_m"),
    "height, drag, rolling resistance, stiffness along, brakes, lean": more(
        "cog_height_m",
        "drag_kgpm",
        "front_brake_frac",
        "engine_brake_mps2",
        "roll_gradient_s2pm",
        "pitch_gradient_s2pm",
        tyre=("along_stiffness_ratio", "rolling_resistance_ratio"),
    ),
    "the wrong axle driven (front wheels alone instead of 60 %)": replace(HANDLING, front_drive_frac=1.0),
}


@pytest.fixture(scope="module")
def drives():
    wanted = np.column_stack([winding(*case) for case in CASES])
    cars = driven(tuple(friction_mu for friction_mu, _ in CASES), wanted)
    return {case: (car, told_of(car)["grip_all_best_mu"]) for case, car in zip(CASES, cars, strict=True)}


def shifts(drives, handling):
    """Return the largest shift of the best friction at each use of the grip, in natural logarithms. (3,)"""
    moved = [np.log(told_of(car, handling=handling)["grip_all_best_mu"] / best) for car, best in drives.values()]
    return np.abs(moved).reshape(len(USES_RATIO), -1).max(axis=1)


@pytest.fixture(scope="module")
def rows(project_root):
    page = (project_root / "docs" / "vehicle.md").read_text(encoding="utf-8")
    table = page[page.index("| declared 10 % too large |") :].split("\n\n")[0].splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in table]
    return {name: [float(re.findall(r"[\d.]+", cell)[0]) / 100.0 for cell in told] for name, *told in cells}


def test_the_page_has_a_row_for_everything_that_is_tried(rows):
    assert set(rows) == set(DECLARED)


@pytest.mark.parametrize("name", DECLARED)
def test_a_declaration_that_is_wrong_by_a_tenth_shifts_the_friction_as_told(drives, rows, name):
    assert shifts(drives, DECLARED[name]) == pytest.approx(rows[name], rel=0.1, abs=TOLD)


@pytest.mark.parametrize("name", [name for name in DECLARED if "axle driven" not in name])
def test_near_the_limit_the_force_itself_tells_the_friction_whatever_is_declared(drives, name):
    assert shifts(drives, DECLARED[name])[-1] < 0.04
