"""Our car beside somebody else's multi-body car; the page docs/simulator-validation.md explains what is left."""

import json
from functools import cache

import pytest

pytest.importorskip("vehiclemodels", reason="the oracle, commonroad-vehicle-models, is not installed")

from bench.simulator_oracle import (
    OracleCar,
    Variant,
    comparable_car,
    oracle_parameters,
    oracle_tyre_force_n,
    our_tyre_force_n,
)
from bench.validation import bounds
from bench.validation.side_by_side import (
    LOW_MU,
    braking,
    braking_figures,
    circle_figures,
    compared,
    drive_both,
    lane_change,
    lane_change_figures,
    step_figures,
    step_steer,
    widening_circle,
)
from bench.validation.tables import page_with_tables

pytestmark = pytest.mark.sim

STEADY = ("steady_yaw_rate_radps", "peak_yaw_rate_radps", "steady_accel_y_mps2", "steady_roll_rad")


@cache
def our(car):
    return comparable_car(oracle_parameters(car))


def both(manoeuvre, car, variant):
    return drive_both(manoeuvre, car, variant, vehicle=our(car))


@pytest.mark.parametrize("axis", ["x", "y"])
def test_our_tyre_takes_the_shape_of_the_oracles(axis):
    plain = oracle_parameters(OracleCar.BMW_320I, Variant.NO_CAMBER)
    tyre, peak = our(OracleCar.BMW_320I).tyre, getattr(plain.tire, f"p_d{axis}1")
    for slip in (0.005, 0.02, 0.05, 0.1, 0.2, 0.5):
        theirs = oracle_tyre_force_n(plain, axis, slip=slip, load_n=3e3)
        ours = our_tyre_force_n(tyre, axis, slip=slip, load_n=3e3, friction_mu=peak)
        assert ours == pytest.approx(theirs, abs=0.025 * peak * 3e3)


@pytest.mark.parametrize("car", list(OracleCar))
@pytest.mark.parametrize(("accel_mps2", "friction_mu"), [(4.0, None), (2.0, LOW_MU)])
def test_a_step_of_the_steering_is_answered_as_by_the_plain_oracle(car, accel_mps2, friction_mu):
    step = step_steer(oracle_parameters(car), accel_mps2=accel_mps2, friction_mu=friction_mu)
    found = compared(both(step, car, Variant.PLAIN), step_figures)
    for name in STEADY:
        assert abs(found["over_ratio"][name]) < bounds.STEADY_RATIO[Variant.PLAIN], name
    overshoot = found["ours"]["overshoot_ratio"] - found["theirs"]["overshoot_ratio"]
    assert abs(overshoot) < bounds.OVERSHOOT_RATIO[Variant.PLAIN]
    assert abs(found["ours"]["rise_time_s"] - found["theirs"]["rise_time_s"]) < bounds.RISE_TIME_S[Variant.PLAIN]


@pytest.mark.parametrize("car", list(OracleCar))
def test_a_step_of_the_steering_is_answered_nearly_as_by_the_published_oracle(car):
    step = step_steer(oracle_parameters(car), accel_mps2=6.0)
    found = compared(both(step, car, Variant.PUBLISHED), step_figures)
    for name in STEADY:
        assert abs(found["over_ratio"][name]) < bounds.STEADY_RATIO[Variant.PUBLISHED], name


def test_the_axle_masses_explain_how_much_more_the_oracle_understeers():
    # The front axle's load over its lever against the rear one's; both tyres are alike.
    car, accel = OracleCar.FORD_ESCORT, 2.0
    p = oracle_parameters(car, Variant.NO_CAMBER)
    wheelbase, slope = p.a + p.b, -p.tire.p_ky1
    front_kg, rear_kg = p.m_s * p.b / wheelbase + p.m_uf, p.m_s * p.a / wheelbase + p.m_ur
    # Slip per lateral acceleration of each axle, in rad per g.
    gradient = (p.m * p.b / wheelbase / front_kg - p.m * p.a / wheelbase / rear_kg) / slope
    expected = -gradient * 20.0**2 / (9.81 * wheelbase)
    found = compared(both(step_steer(p, accel_mps2=accel), car, Variant.NO_CAMBER), step_figures)
    assert found["over_ratio"]["steady_yaw_rate_radps"] == pytest.approx(abs(expected), abs=0.01)


def test_the_widening_circle_takes_the_same_steering():
    car = OracleCar.BMW_320I
    found = compared(both(widening_circle(oracle_parameters(car)), car, Variant.PLAIN), circle_figures)
    for name, over in found["over_ratio"].items():
        assert abs(over) < bounds.STEADY_RATIO[Variant.PLAIN], name


@pytest.mark.parametrize("variant", [Variant.PUBLISHED, Variant.PLAIN])
@pytest.mark.parametrize("back", [False, True])
def test_lane_changes_are_the_same(variant, back):
    car = OracleCar.BMW_320I
    change = lane_change(oracle_parameters(car), accel_mps2=5.0, back=back)
    found = lane_change_figures(both(change, car, variant))
    assert abs(found["peak_yaw_rate_over_ratio"]) < bounds.LANE_CHANGE_PEAK_RATIO[variant]
    assert abs(found["peak_accel_y_over_ratio"]) < bounds.LANE_CHANGE_PEAK_RATIO[variant]
    assert found["yaw_rate_rms_over_peak_ratio"] < bounds.LANE_CHANGE_RMS_RATIO[variant]


def test_brakes_stop_both_in_the_same_distance():
    found = braking_figures(both(braking(decel_mps2=7.0), OracleCar.BMW_320I, Variant.PUBLISHED))
    assert abs(found["over_ratio"]) < bounds.BRAKING_RATIO


def test_the_page_holds_the_figures_of_the_last_validation(project_root):
    results = project_root / "docs" / "results" / "simulator" / "validation.json"
    page = (project_root / "docs" / "simulator-validation.md").read_text(encoding="utf-8")
    assert page_with_tables(page, json.loads(results.read_text(encoding="utf-8"))) == page


def test_the_figures_of_the_last_validation_are_within_their_bounds(project_root):
    results = project_root / "docs" / "results" / "simulator" / "validation.json"
    kept = json.loads(results.read_text(encoding="utf-8"))
    body, limits = kept["body"], kept["limits"]
    assert abs(body["steady_circle"]["gradient_over_linear_ratio"] - 1.0) < bounds.UNDERSTEER_RATIO
    assert body["step_steer"]["largest_deviation_over_peak_ratio"] < bounds.STEP_STEER_RATIO
    assert body["eigenvalues"]["frequency_largest_error_ratio"] < bounds.EIGENVALUE_RATIO
    assert body["eigenvalues"]["damping_largest_error_ratio"] < bounds.EIGENVALUE_RATIO
    for row in limits["lateral"]:
        assert abs(row["over_load_sensitive_limit_ratio"] - 1.0) < bounds.LIMIT_RATIO, row
    for row in limits["longitudinal"]:
        assert abs(row["braking_balanced_over_limit_ratio"] - 1.0) < bounds.LIMIT_RATIO, row
        assert abs(row["driving_balanced_over_limit_ratio"] - 1.0) < bounds.LIMIT_RATIO, row
    used = kept["time_step"]["motion_statistics_over_largest_magnitude"]["step_2_ms"]
    assert used["q95_ratio"] < bounds.TIME_STEP_Q95_RATIO
    assert all(kept["roughness"][f"class_{name}"]["inside_band_frac"] == 1.0 for name in "abcd")
    for car in OracleCar:
        for variant in Variant:
            for name, found in kept["oracle"][car.name.lower()][variant.name.lower()].items():
                if name.startswith("step_"):
                    within = {key: abs(found["over_ratio"][key]) < bounds.STEADY_RATIO[variant] for key in STEADY}
                    assert all(within.values()), (car, variant, name, within)
