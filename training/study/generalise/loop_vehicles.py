"""Vehicles of the closed loop: simulated, and summarised by the onboard client as those of any design are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roadgrip.section import RoadSection
from training.chance import chance
from training.closed_loop import Drive, Passed, Traveller, draw_travellers
from training.dataset import COMPLETED
from training.passage_rows import rows_of
from training.scenarios import WITH_GNSS_FRAC, Run, Scenario, Terms, attempted, surveyed_map
from vehicle_client.estimation.handling import XC90_HANDLING
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.simulator.drive import DriveOutcome
from vehicle_client.simulator.plan import PassagePlan, SensorGrade, draw_plan
from vehicle_client.simulator.run import each_passage

DESIGN_NAME = "closed-loop"


def travellers(
    section: RoadSection, *, phases_mu: Sequence[float], phase_s: float, vehicles_per_hour: float, terms: Terms
) -> tuple[Traveller, ...]:
    """Return the vehicles that come to a road while its friction changes, the paper's drivers and tyres.

    Args:
        section: The road.
        phases_mu: Base friction of one phase after the other.
        phase_s: How long each lasts.
        vehicles_per_hour: How many there are.
        terms: Seed and sensors.
    """

    def plan_at(rng: np.random.Generator, at_s: float) -> PassagePlan:
        return draw_plan(
            rng,
            section=section,
            base_friction_mu=phases_mu[min(int(at_s // phase_s), len(phases_mu) - 1)],
            grade=terms.sensor_grade,
            kind=terms.driver_kind,
            with_gnss=bool(rng.random() < WITH_GNSS_FRAC) and bool(section.anchors),
        )

    return draw_travellers(
        chance(terms.seed, f"{terms.design_name}|{section.section_id}"),
        until_s=phase_s * len(phases_mu),
        vehicles_per_hour=vehicles_per_hour,
        plan_at=plan_at,
    )


def simulated(section: RoadSection, terms: Terms) -> Drive:
    """Return what drives plans over a road.

    Args:
        section: The road.
        terms: Seed and sensors; what vehicles know of the road follows from them.
    """
    road_map = surveyed_map(terms, section)
    scenario = Scenario(DESIGN_NAME, section, attempted(0))

    def drive(plans: Sequence[PassagePlan]) -> Sequence[Passed]:
        runs = [Run(f"{DESIGN_NAME}/{i}", i, plan, XC90, XC90_HANDLING) for i, plan in enumerate(plans)]
        drives = list(each_passage(section, plans))
        rows = rows_of(scenario, runs, drives, road_map=road_map)
        return [
            Passed(
                row=rows.features[i] if rows.outcome[i] == COMPLETED else None,
                kept_to_road=drives[i].outcome is DriveOutcome.COMPLETED,
                duration_s=float(rows.labels["duration_s"][i]),
                label_mu=float(rows.labels["label_mu"][i]),
                mean_speed_mps=float(rows.labels["mean_speed_mps"][i]),
                peak_utilisation_ratio=float(rows.labels["peak_utilisation_ratio"][i]),
            )
            for i in range(len(plans))
        ]

    return drive


def terms_of(seed: int, grade: SensorGrade) -> Terms:
    """Return what all vehicles of the loop share."""
    return Terms(DESIGN_NAME, seed, grade)
