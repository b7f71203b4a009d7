"""How much a drive speaks for having passed a section: four comparisons, one weighted sum, one probability.

The sum is a logarithm of odds: how much likelier what was measured is on the section than on any other road. Its
weights are a logistic regression on drives over random roads, each compared with its own map and with those of others
(decision 0011); none of those roads is among the ones that the accuracy of the matching is stated on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vehicle_client.mapmatch.alignment import FINE_STEP_M, value_at
from vehicle_client.mapmatch.waypoints import vote_of_waypoints

if TYPE_CHECKING:
    from roadgrip.units import FloatArray
    from vehicle_client.mapmatch.alignment import Alignment, MappedStretch, MetredDrive
    from vehicle_client.mapmatch.waypoints import Waypoints

POSITION_STD_LIMIT_M = 15.0
HEADING_RMS_LIMIT_RAD = 0.15
"""Beyond it nothing else is looked at."""
CONFIDENCE_MIN_FRAC = 0.8
"""Below one foreign road in a hundred on random roads; a higher one would refuse cars that slide on slippery roads."""


class Weights(NamedTuple):
    """What the log odds are made of: the vote as it is, all else by the logarithm of itself plus its floor.

    Attributes:
        start_ratio: Before anything is looked at.
        vote_ratio: Of the waypoints.
        curvature_ratio: Of the curvature misfit.
        lateral_ratio: Of the distance between the lines.
        height_ratio: Of the difference in height.
        length_ratio: Of the length.
        turned_ratio: Of the angle that the section turns.
        places_ratio: Of the number of places.
    """

    start_ratio: float
    vote_ratio: float
    curvature_ratio: float
    lateral_ratio: float
    height_ratio: float
    length_ratio: float
    turned_ratio: float
    places_ratio: float


PLANE_WEIGHTS = Weights(
    start_ratio=-6.46,
    vote_ratio=0.90,
    curvature_ratio=-2.00,
    lateral_ratio=-3.28,
    height_ratio=0.00,
    length_ratio=0.34,
    turned_ratio=1.42,
    places_ratio=-0.83,
)
"""For drives without heights."""
SPATIAL_WEIGHTS = Weights(
    start_ratio=-7.10,
    vote_ratio=0.89,
    curvature_ratio=-1.94,
    lateral_ratio=-3.29,
    height_ratio=-0.15,
    length_ratio=0.42,
    turned_ratio=1.44,
    places_ratio=-0.83,
)
"""For drives with heights."""
CURVATURE_FLOOR_FRAC = 0.02
LATERAL_FLOOR_M = 0.1
HEIGHT_FLOOR_M = 0.05
_TURNED_MIN_RAD = 0.01
_USUAL_CURVATURE_FRAC, _USUAL_LATERAL_M, _USUAL_HEIGHT_M = 0.1, 0.3, 0.15
"""What nine of ten drives over the right road stay below."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """What an alignment of a drive with a stretch of map shows.

    Attributes:
        vote_ratio: Of the waypoints, see `vote_of_waypoints`.
        curvature_misfit_frac: Difference of driven and mapped curvature over the mapped one, both root mean squares.
        lateral_rms_m: Distance between the driven line and the mapped one, laid over each other: the residual heading
            integrated, without a straight line.
        height_rms_m: Difference of the heights, without what else an accelerometer takes for a climb: its offset (a
            straight line over the distance), its scale and the car's pitching (a share of the speed squared), and
            sideslip (the lateral acceleration squared, summed up). None if the drive has no height.
        length_m: Of the stretch: what a gyro and an accelerometer add up to grows with it.
        turned_rad: What it turns, left and right added up: two lines lie apart by more where a road turns more.
        places_count: How many sections of this length the drive has room for: each is a chance to be wrong.
        position_std_m: Standard deviation of the stations.
    """

    vote_ratio: float
    curvature_misfit_frac: float
    lateral_rms_m: float
    height_rms_m: float | None
    length_m: float
    turned_rad: float
    places_count: float
    position_std_m: float

    @property
    def log_odds(self) -> float:
        """Logarithm of the odds that this is the section, where it is as likely as not before looking."""
        weights = PLANE_WEIGHTS if self.height_rms_m is None else SPATIAL_WEIGHTS
        height_m = 0.0 if self.height_rms_m is None else self.height_rms_m
        return (
            weights.start_ratio
            + weights.vote_ratio * self.vote_ratio
            + weights.curvature_ratio * float(np.log(self.curvature_misfit_frac + CURVATURE_FLOOR_FRAC))
            + weights.lateral_ratio * float(np.log(self.lateral_rms_m + LATERAL_FLOOR_M))
            + weights.height_ratio * float(np.log(height_m + HEIGHT_FLOOR_M))
            + weights.length_ratio * float(np.log(self.length_m))
            + weights.turned_ratio * float(np.log(self.turned_rad))
            + weights.places_ratio * float(np.log(self.places_count))
        )

    @property
    def confidence_frac(self) -> float:
        """Probability that this is the section, where it is as likely as not before looking."""
        return float(1.0 / (1.0 + np.exp(-np.clip(self.log_odds, -50.0, 50.0))))

    @property
    def convincing(self) -> bool:
        """Whether a vehicle may report on the section."""
        return self.confidence_frac >= CONFIDENCE_MIN_FRAC and self.position_std_m <= POSITION_STD_LIMIT_M

    @property
    def told(self) -> str:
        """What is worst about it, in words."""
        if self.position_std_m > POSITION_STD_LIMIT_M:
            return f"the section bends too little to say where on it the car was (to {self.position_std_m:.0f} m)"
        worst, text = max(
            (
                self.curvature_misfit_frac / _USUAL_CURVATURE_FRAC,
                f"curvature differs by {self.curvature_misfit_frac:.0%}",
            ),
            (self.lateral_rms_m / _USUAL_LATERAL_M, f"the lines lie {self.lateral_rms_m:.1f} m apart"),
            ((self.height_rms_m or 0.0) / _USUAL_HEIGHT_M, f"heights differ by {self.height_rms_m or 0.0:.1f} m"),
        )
        if worst > 1.0:
            return f"at the best place {text}"
        return f"too few and too gentle bends to tell it from other roads (confidence {self.confidence_frac:.2f})"


def evidence_of(
    drive: MetredDrive, stretch: MappedStretch, waypoints: Waypoints, alignment: Alignment
) -> Evidence | None:
    """Return what an alignment shows; None where nothing can: headings far apart, or a map without waypoints.

    Args:
        drive: The drive.
        stretch: Of the map.
        waypoints: Of the map; those beyond the stretch are left out.
        alignment: Of the two.
    """
    asked = waypoints.station_m <= stretch.length_m
    if alignment.residual_rms_rad > HEADING_RMS_LIMIT_RAD or not asked.any():
        return None
    at = alignment.driven_m(stretch.station_m)
    off = value_at(drive.curvature_1pm, at) - stretch.curvature_1pm
    height = None
    if drive.height_m is not None:
        above = value_at(drive.height_m, at) - stretch.height_m
        slid = np.cumsum(value_at(drive.accel_y_mps2, at) ** 2)
        height = _rms(_without(above, stretch.centred_m, value_at(drive.speed_mps, at) ** 2, slid))
    return Evidence(
        vote_ratio=vote_of_waypoints(
            value_at(drive.curvature_1pm, alignment.driven_m(waypoints.station_m[asked])),
            mapped_1pm=waypoints.curvature_1pm[asked],
        ),
        curvature_misfit_frac=_rms(off) / max(1e-9, _rms(stretch.curvature_1pm)),
        lateral_rms_m=_rms(_without(np.cumsum(alignment.residual_rad) * FINE_STEP_M, stretch.centred_m)),
        height_rms_m=height,
        length_m=stretch.length_m,
        turned_rad=max(_TURNED_MIN_RAD, float(np.abs(np.diff(stretch.heading_rad)).sum())),
        places_count=max(1.0, drive.length_m / stretch.length_m),
        position_std_m=alignment.position_std_m,
    )


def _without(values: FloatArray, *nuisances: FloatArray) -> FloatArray:
    """Return values less their best fit by a constant and the nuisances."""
    columns = np.column_stack([np.ones_like(values), *(column - column.mean() for column in nuisances)])
    left: FloatArray = values - columns @ np.linalg.lstsq(columns, values, rcond=1e-9)[0]
    return left


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
