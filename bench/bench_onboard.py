"""What the onboard client costs: a whole passage from sensors to summary, over one plain pass over its samples.

python bench/bench_onboard.py          the table, and bench/results/onboard.json

The drives are simulated with automotive sensors. The floor is one multiplication of every recorded sample into a new
array: no estimation can be cheaper than reading its input once. Times are CPU time of the calling thread, the best of
some rounds, so that a busy machine shows little.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable

import numpy as np

from bench.measurement import ROADS, cost_s, keep_figures, parser_of, table_of
from roadgrip.section import RoadSection
from roadgrip.sections import read_section
from roadgrip.units import SAMPLE_S, FloatArray
from vehicle_client.estimation.observer import PAPER_PARAMETERS
from vehicle_client.estimation.signals import kinematic_signals
from vehicle_client.estimation.summary import kinematic_summary
from vehicle_client.estimation.trace import Trace
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.simulator.run import SensorGrade, draw_plan, simulate_passage

PASSAGE_S = 40.0
"""What figures are scaled to, so that roads compare."""
BASE_FRICTION_MU = 0.5
SEED = 3


def completed_drive(section: RoadSection, *, with_gnss: bool) -> Trace:
    """Return the trace of the first drawn drive that stays on the road."""
    rng = np.random.default_rng(SEED)
    for _ in range(50):
        plan = draw_plan(
            rng,
            section=section,
            base_friction_mu=BASE_FRICTION_MU,
            grade=SensorGrade.AUTOMOTIVE,
            with_gnss=with_gnss,
        )
        drive = simulate_passage(section, plan)
        if drive.completed:
            return drive.trace
    raise RuntimeError(f"nobody came through {section.section_id}")


def recorded(trace: Trace) -> FloatArray:
    """Return all that the inertial unit, the steering and the wheels recorded. (n, 9)"""
    return np.column_stack(
        [
            trace.accel_x_mps2,
            trace.accel_y_mps2,
            trace.roll_rate_radps,
            trace.yaw_rate_radps,
            trace.steer_rad,
            trace.wheel_speed_mps,
        ]
    )


def cost_ms(work: Callable[[], object]) -> float:
    """Return the CPU time of one call."""
    return 1e3 * cost_s(work, clock=time.thread_time, rounds_count=9, budget_s=0.15)


def passage_costs(name: str, *, with_gnss: bool) -> dict[str, str | float]:
    """Return what one passage over a road costs, in all and by its two large parts."""
    section = read_section(name)
    trace = completed_drive(section, with_gnss=with_gnss)
    result = summarise_passage(trace, section)
    if not isinstance(result, Summarised):
        raise RuntimeError(f"{name}: {result}")  # noqa: TRY004 - a refusal is a value, not a wrong type
    samples = recorded(trace)
    duration_s = trace.samples_count * SAMPLE_S
    per_passage = PASSAGE_S / duration_s
    inside = result.match.inside(trace.time_s)

    def estimate() -> object:
        return kinematic_signals(
            trace,
            section,
            station_m=result.match.station_m,
            vehicle=XC90,
            parameters=PAPER_PARAMETERS,
            offsets=result.offsets,
        )

    whole_ms = cost_ms(lambda: summarise_passage(trace, section)) * per_passage
    estimate_ms = cost_ms(estimate) * per_passage
    statistics_ms = cost_ms(lambda: kinematic_summary(result.signals, inside, duration_s=1.0)) * per_passage
    floor_ms = cost_ms(lambda: samples * 1.0000001) * per_passage
    return {
        "road": name,
        "matched by": "satellites" if with_gnss else "motion",
        "trace s": duration_s,
        "whole ms": whole_ms,
        "estimation ms": estimate_ms,
        "statistics ms": statistics_ms,
        "match and rest ms": whole_ms - estimate_ms - statistics_ms,
        "floor ms": floor_ms,
        "whole over floor": whole_ms / floor_ms,
        "share of real time %": whole_ms / (PASSAGE_S * 1e3) * 100.0,
    }


def main() -> None:
    """Print the table and keep the figures."""
    arguments = parser_of(__doc__, results_name="onboard.json").parse_args()
    rows = [passage_costs(name, with_gnss=with_gnss) for name in ROADS for with_gnss in (False, True)]
    print(f"the onboard client, per {PASSAGE_S:.0f} s of recording ({platform.machine()}, numpy {np.__version__})\n")
    print(table_of(rows, number_format=".3g"))
    keep_figures(arguments.out, {"per_passage_s": PASSAGE_S, "rows": rows})


if __name__ == "__main__":
    main()
