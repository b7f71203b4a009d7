"""How far the simulator may be from theory and from the oracle: the page states it, tests hold it.

Each bound is what physics that is left out explains, rounded up; the page says which.
"""

from __future__ import annotations

from bench.simulator_oracle import Variant

UNDERSTEER_RATIO = 0.03
ROLL_RATIO = 0.03
STEP_STEER_RATIO = 0.03
EIGENVALUE_RATIO = 0.03
FREE_ROLL_RATIO = 1e-3
LIMIT_RATIO = 0.02
TIME_STEP_Q95_RATIO = 0.01
"""Of the statistics of a drive's motion, over the signal's largest magnitude."""

STEADY_RATIO = {Variant.PUBLISHED: 0.12, Variant.NO_CAMBER: 0.08, Variant.PLAIN: 0.02}
"""Of the oracle: steady and peak yaw rate, lateral acceleration and roll of steps; steering angle in the circle."""
OVERSHOOT_RATIO = {Variant.PUBLISHED: 0.02, Variant.NO_CAMBER: 0.02, Variant.PLAIN: 0.015}
"""Difference of the overshoots, each over the steady yaw rate."""
RISE_TIME_S = {Variant.PUBLISHED: 0.06, Variant.NO_CAMBER: 0.04, Variant.PLAIN: 0.015}
LANE_CHANGE_PEAK_RATIO = {Variant.PUBLISHED: 0.12, Variant.NO_CAMBER: 0.06, Variant.PLAIN: 0.025}
LANE_CHANGE_RMS_RATIO = {Variant.PUBLISHED: 0.06, Variant.NO_CAMBER: 0.05, Variant.PLAIN: 0.02}
"""Root mean square of the difference of the yaw rates over their peak."""
BRAKING_RATIO = 0.005
