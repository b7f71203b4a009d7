"""What the physical inverse must know of the own car: masses, how loads shift, and the shape of its tyres' curve.

These are constants a maker knows and an integrator declares; a car may come to know its own better over many passages.
They are never read from the world the car drives in.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TyreCurve:
    """How force follows slip, per unit of load; friction scales the peak and its slip, never the slope at zero slip.

    Attributes:
        nominal_load_n: Load of one wheel at which the numbers hold.
        stiffness_ratio: Lateral force per slip angle (rad) and load at small slip.
        stiffness_twice_ratio: At twice the nominal load.
        peak_twice_ratio: Peak force over load at twice the nominal load, as a share of that at the nominal load.
        peak_slip_ratio: Slip of the peak where the friction is 1.
        peak_slip_twice_ratio: At twice the nominal load.
        along_stiffness_ratio: Longitudinal force per slip and load at small slip, at any load.
        relaxation_m: Distance over which the force builds up.
        rolling_resistance_ratio: Rolling resistance over load.

    References:
        Rill, Road Vehicle Dynamics, chapter 3 (TMeasy): the rising branch of the curve.
    """

    nominal_load_n: float
    stiffness_ratio: float
    stiffness_twice_ratio: float
    peak_twice_ratio: float
    peak_slip_ratio: float
    peak_slip_twice_ratio: float
    along_stiffness_ratio: float
    relaxation_m: float
    rolling_resistance_ratio: float


@dataclass(frozen=True, slots=True)
class Handling:
    """A car as a model of two axles with two wheels each.

    Attributes:
        mass_kg: As driven.
        yaw_inertia_kgm2: About the vertical axis through the centre of gravity.
        cog_height_m: Height of the centre of gravity.
        front_transfer_height_m: Lateral load shift of the front axle times its track over mass times lateral force
            per mass: that axle's share of the height, the lean of the body included.
        rear_transfer_height_m: The same of the rear axle.
        roll_gradient_s2pm: Lean per lateral specific force, rad per m/s2.
        pitch_gradient_s2pm: Nose-down angle per deceleration, rad per m/s2.
        drag_kgpm: Air drag force over speed squared.
        front_drive_frac: Share of the drive torque on the front axle.
        front_brake_frac: Share of the brake torque on the front axle.
        engine_brake_mps2: Deceleration by the engine alone; what goes beyond is braked.
        steer_compliance_radpn: How far the front wheels give way to the lateral force of their axle.
        tyre: Of all four wheels.
    """

    mass_kg: float
    yaw_inertia_kgm2: float
    cog_height_m: float
    front_transfer_height_m: float
    rear_transfer_height_m: float
    roll_gradient_s2pm: float
    pitch_gradient_s2pm: float
    drag_kgpm: float
    front_drive_frac: float
    front_brake_frac: float
    engine_brake_mps2: float
    steer_compliance_radpn: float
    tyre: TyreCurve


XC90_HANDLING = Handling(
    mass_kg=2100.0,
    yaw_inertia_kgm2=4250.0,
    cog_height_m=0.70,
    front_transfer_height_m=0.398,
    rear_transfer_height_m=0.349,
    roll_gradient_s2pm=0.0080,
    pitch_gradient_s2pm=0.003,
    drag_kgpm=0.56,
    front_drive_frac=0.6,
    front_brake_frac=0.65,
    engine_brake_mps2=0.5,
    steer_compliance_radpn=1.63e-6,
    tyre=TyreCurve(
        nominal_load_n=5199.0,
        stiffness_ratio=14.99,
        stiffness_twice_ratio=10.05,
        peak_twice_ratio=0.893,
        peak_slip_ratio=0.1805,
        peak_slip_twice_ratio=0.2427,
        along_stiffness_ratio=18.68,
        relaxation_m=0.26,
        rolling_resistance_ratio=0.010,
    ),
)
"""Declared estimates of the paper's car; wheelbase, track and axles stand in `VehicleGeometry`."""
