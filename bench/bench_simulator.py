"""How fast the simulator drives: simulated seconds per CPU second, on one core.

python bench/bench_simulator.py             the table, and bench/results/simulator.json
python bench/bench_simulator.py --runs 200  more drives per road and grade

Everything is on: driver, stability systems, roughness, sensors. Drives that leave the road count with what they drove.
Drives are simulated side by side, so that few of them at a time would leave lanes empty. The compiled part alone is
timed on the same drives; the rest draws noise and packs arrays. Compiling is not counted.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Mapping, Sequence

import numba
import numpy as np

from bench.measurement import ROADS, keep_figures, parser_of, table_of
from roadgrip.sections import read_section
from roadgrip.units import SAMPLE_S
from vehicle_client.simulator import journey
from vehicle_client.simulator.run import SensorGrade, draw_plan, each_passage, warm_up

BASE_FRICTIONS_MU = (0.25, 0.35, 0.5, 0.7)
SEED = 11


class Stopwatch:
    """CPU time spent inside the compiled part, measured by standing in its place."""

    def __init__(self) -> None:
        """Start at zero."""
        self.cpu_s = 0.0
        self._drive = journey.drive

    def __call__(self, *arguments: object) -> None:
        """Drive all lanes until one has ended, and add what it took."""
        started_s = time.process_time()
        self._drive(*arguments)
        self.cpu_s += time.process_time() - started_s


def speed_of(name: str, grade: SensorGrade, *, runs_count: int) -> dict[str, str | float]:
    """Return how fast the drives over one road are simulated."""
    section = read_section(name)
    rng = np.random.default_rng(SEED)
    plans = [
        draw_plan(rng, section=section, base_friction_mu=BASE_FRICTIONS_MU[i % len(BASE_FRICTIONS_MU)], grade=grade)
        for i in range(runs_count)
    ]
    stopwatch = Stopwatch()
    journey.drive, original = stopwatch, journey.drive
    completed_count, samples_count = 0, 0
    try:
        started_s = time.process_time()
        for drive in each_passage(section, plans):
            completed_count += drive.completed
            samples_count += drive.trace.samples_count
        cpu_s = time.process_time() - started_s
    finally:
        journey.drive = original
    simulated_s = samples_count * SAMPLE_S
    return {
        "road": name,
        "sensors": grade.value,
        "drives": float(runs_count),
        "completed": float(completed_count),
        "simulated s": simulated_s,
        "CPU s": cpu_s,
        "simulated s per CPU s": simulated_s / cpu_s,
        "of the compiled part": simulated_s / stopwatch.cpu_s,
        "step us": stopwatch.cpu_s / simulated_s * journey.STEP_S * 1e6,
    }


def overall_speed_ratio(rows: Sequence[Mapping[str, str | float]]) -> float:
    """Return simulated seconds per CPU second over all rows together."""
    return sum(float(row["simulated s"]) for row in rows) / sum(float(row["CPU s"]) for row in rows)


def main() -> None:
    """Print the table and keep the figures."""
    parser = parser_of(__doc__, results_name="simulator.json")
    parser.add_argument("--runs", type=int, default=160, help="drives per road and sensor grade")
    arguments = parser.parse_args()
    warm_up()
    rows = [speed_of(name, grade, runs_count=arguments.runs) for name in ROADS for grade in SensorGrade]
    overall = overall_speed_ratio(rows)
    print(f"the simulator on one core ({platform.machine()}, numba {numba.__version__})\n")
    print(table_of(rows, number_format=".4g"))
    print(f"in all {overall:.0f} simulated seconds per CPU second")
    keep_figures(arguments.out, {"simulated_s_per_cpu_s": overall, "rows": rows})


if __name__ == "__main__":
    main()
