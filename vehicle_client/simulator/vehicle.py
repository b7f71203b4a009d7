"""The numbers of one car: a Volvo XC90 of 2015 on 275/45R20 tyres, with one driver.

Published are wheelbase, tracks, tyre size and kerb mass. Everything marked *estimate* is a declared estimate of what a
large car of that kind has; nothing here was fitted to a measurement. The records are named tuples of floats, so that
compiled code reads them by name.

References:
    Dimensions: Volvo Car Corporation, XC90 owner's data of model year 2016. Tyre: `vehicle_client.simulator.tyre`.
"""

from __future__ import annotations

from typing import NamedTuple


class Tyre(NamedTuple):
    """TMeasy parameters of one tyre; steady state is scaled so that friction is peak force over nominal load.

    Slopes and forces are per newton of load, at the nominal load (`1`) and at twice of it (`2`); slips have no unit.

    Attributes:
        nominal_load_n: Load at which mu equals peak force over load.
        slope_x1_ratio: Longitudinal dF/ds at zero slip over load, at the nominal load.
        slope_x2_ratio: At twice the nominal load.
        peak_x1_ratio: Peak longitudinal force over load at the reference surface.
        peak_x2_ratio: At twice the nominal load.
        peak_slip_x1_ratio: Slip of the peak.
        peak_slip_x2_ratio: At twice the nominal load.
        slide_x1_ratio: Sliding force over load.
        slide_x2_ratio: At twice the nominal load.
        slide_slip_x1_ratio: Slip at which the tyre slides entirely.
        slide_slip_x2_ratio: At twice the nominal load.
        slope_y1_ratio: The same for lateral slip.
        slope_y2_ratio: At twice the nominal load.
        peak_y1_ratio: Peak lateral force over load.
        peak_y2_ratio: At twice the nominal load.
        peak_slip_y1_ratio: Slip of the peak.
        peak_slip_y2_ratio: At twice the nominal load.
        slide_y1_ratio: Sliding force over load.
        slide_y2_ratio: At twice the nominal load.
        slide_slip_y1_ratio: Slip at which the tyre slides entirely.
        slide_slip_y2_ratio: At twice the nominal load.
        stiffness_x_npm: Of the carcass; with the slope it gives the relaxation length. Estimate.
        stiffness_y_npm: The same, lateral. Estimate.
        damping_x_nspm: Of the carcass. Estimate.
        damping_y_nspm: The same, lateral. Estimate.
        rolling_radius_m: Travel over rotation of the free rolling wheel. Estimate (0.97 of the unloaded radius).
        rolling_resistance_ratio: Rolling resistance over load. Estimate.
        vertical_stiffness_npm: Of the loaded tyre. Estimate.
    """

    nominal_load_n: float = 5199.0
    slope_x1_ratio: float = 18.6758
    slope_x2_ratio: float = 20.1757
    peak_x1_ratio: float = 1.1205
    peak_x2_ratio: float = 1.072
    peak_slip_x1_ratio: float = 0.17
    peak_slip_x2_ratio: float = 0.15
    slide_x1_ratio: float = 0.8766
    slide_x2_ratio: float = 0.8245
    slide_slip_x1_ratio: float = 0.90
    slide_slip_x2_ratio: float = 0.95
    slope_y1_ratio: float = 14.9858
    slope_y2_ratio: float = 10.0505
    peak_y1_ratio: float = 1.0084
    peak_y2_ratio: float = 0.90003
    peak_slip_y1_ratio: float = 0.18197
    peak_slip_y2_ratio: float = 0.24472
    slide_y1_ratio: float = 0.83941
    slide_y2_ratio: float = 0.76782
    slide_slip_y1_ratio: float = 0.82534
    slide_slip_y2_ratio: float = 0.91309
    stiffness_x_npm: float = 190_000.0
    stiffness_y_npm: float = 150_000.0
    damping_x_nspm: float = 600.0
    damping_y_nspm: float = 500.0
    rolling_radius_m: float = 0.366
    rolling_resistance_ratio: float = 0.010
    vertical_stiffness_npm: float = 260_000.0


class Vehicle(NamedTuple):
    """Body, suspension, drive and brakes of one car.

    Attributes:
        mass_kg: With driver.
        yaw_inertia_kgm2: About the vertical axis through the centre of gravity. Estimate.
        roll_inertia_kgm2: About the longitudinal axis through the centre of gravity. Estimate.
        front_axle_m: From the centre of gravity to the front axle. Estimate (the wheelbase 2.984 m is published).
        rear_axle_m: From the centre of gravity to the rear axle. Estimate.
        front_track_m: Published.
        rear_track_m: Published.
        cog_height_m: Estimate.
        front_roll_centre_m: Height of the front roll centre. Estimate.
        rear_roll_centre_m: Height of the rear roll centre. Estimate.
        roll_stiffness_nmprad: Springs and anti-roll bars of both axles. Estimate (4.5 degrees per g).
        roll_damping_nmsprad: Estimate (about a third of critical).
        front_roll_stiffness_frac: Share of the front axle in both. Estimate.
        pitch_per_accel_s2pm_ratio: Nose-down angle per deceleration, rad per m/s2. Estimate.
        load_transfer_lag_s: Time in which wheel loads follow a longitudinal acceleration. Estimate.
        wheel_inertia_kgm2: Wheel with its share of the drive train. Estimate.
        unsprung_mass_kg: Of one corner. Estimate.
        wheel_rate_npm: Spring rate at one wheel. Estimate.
        damper_nspm: Damper rate at one wheel. Estimate.
        drag_npm2ps2_ratio: Air drag force over speed squared. Estimate (Cd A = 0.92 m2).
        power_w: Largest at the wheels. Estimate.
        front_drive_frac: Share of the drive torque on the front axle. Estimate.
        front_brake_frac: Share of the brake torque on the front axle. Estimate.
        engine_brake_mps2: Deceleration by the engine with the pedal released. Estimate.
        brake_limit_mps2: Deceleration that the brakes can ask for on dry asphalt. Estimate.
        brake_lag_s: First-order lag of brake and drive torque. Estimate.
        steer_limit_rad: Largest mean angle of the front wheels. Estimate.
        steer_rate_limit_radps: What hands and steering gear manage. Estimate (600 degrees/s at the wheel, ratio 16).
        steer_compliance_radpn: How far the front wheels give way to the lateral force of their axle. Estimate (one
            degree per g of lateral acceleration, steering gear and suspension together).
        steer_compliance_lag_s: First-order lag with which they give way. Estimate.
        tyre: Of all four wheels.
    """

    mass_kg: float = 2100.0
    yaw_inertia_kgm2: float = 4250.0
    roll_inertia_kgm2: float = 850.0
    front_axle_m: float = 1.43
    rear_axle_m: float = 1.554
    front_track_m: float = 1.665
    rear_track_m: float = 1.676
    cog_height_m: float = 0.70
    front_roll_centre_m: float = 0.08
    rear_roll_centre_m: float = 0.12
    roll_stiffness_nmprad: float = 170_000.0
    roll_damping_nmsprad: float = 11_000.0
    front_roll_stiffness_frac: float = 0.55
    pitch_per_accel_s2pm_ratio: float = 0.003
    load_transfer_lag_s: float = 0.08
    wheel_inertia_kgm2: float = 2.0
    unsprung_mass_kg: float = 48.0
    wheel_rate_npm: float = 35_000.0
    damper_nspm: float = 3_200.0
    drag_npm2ps2_ratio: float = 0.56
    power_w: float = 165_000.0
    front_drive_frac: float = 0.6
    front_brake_frac: float = 0.65
    engine_brake_mps2: float = 0.5
    brake_limit_mps2: float = 11.0
    brake_lag_s: float = 0.08
    steer_limit_rad: float = 0.60
    steer_rate_limit_radps: float = 0.65
    steer_compliance_radpn: float = 1.63e-6
    steer_compliance_lag_s: float = 0.02
    tyre: Tyre = Tyre()

    @property
    def wheelbase_m(self) -> float:
        """Distance between the axles."""
        return self.front_axle_m + self.rear_axle_m


XC90 = Vehicle()
"""The car of the paper, as far as it is known."""
