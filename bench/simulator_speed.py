"""How fast the simulator is beside the oracle, and how long the paper's design takes: one file of figures.

python -m bench.simulator_speed             the table, and docs/results/simulator/speed.json
python -m bench.simulator_speed --runs 200  more drives per road and sensor grade

Ours: whole drives of all three roads with driver, stability systems, roughness and sensors, on one core. The oracle:
the multi-body model of CommonRoad (see `bench.simulator_oracle`), its state alone, solved as its documentation does.
Both in one process, one after the other, in CPU time of the process, so that a busy machine shows little. Compiling is
not counted. The minutes of the paper's design are those that its own run measured.
"""

from __future__ import annotations

import importlib.metadata
import json
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import odeint

from bench.bench_simulator import overall_speed_ratio, speed_of
from bench.measurement import ROADS, keep_figures, parser_of, processor, table_of
from bench.simulator_oracle import (
    YAW_RATE,
    Manoeuvre,
    OracleCar,
    drive_oracle,
    oracle_parameters,
    right_hand_side,
)
from roadgrip.units import SAMPLE_S, FloatArray
from vehicle_client.simulator.journey import STEP_S
from vehicle_client.simulator.run import SensorGrade, compiled_cache_key, warm_up

RESULTS_FOLDER = Path(__file__).resolve().parents[1] / "docs" / "results" / "simulator"
ROUNDS_COUNT = 3


@dataclass(frozen=True, slots=True)
class OracleSpeed:
    """How fast the oracle is simulated by one way of solving it.

    Attributes:
        solver: What solves it.
        sim_seconds_per_cpu_second: On one core.
        yaw_rate_error_ratio: Largest error of the yaw rate over its peak, against a tight solution.
    """

    solver: str
    sim_seconds_per_cpu_second: float
    yaw_rate_error_ratio: float


DOCUMENTED = "odeint, default tolerances, output every 10 ms"
"""What the package's README and examples do."""


def oracle_speed() -> list[OracleSpeed]:
    """Return how fast the oracle is, by the documented way first, on 10 s of steering that changes every 10 ms.

    That is what a driver's hands do, so it is what a drive costs; the steering is a sine of 0.5 Hz and some 4 m/s2.
    """
    from vehiclemodels.init_mb import init_mb

    parameters = oracle_parameters(OracleCar.BMW_320I)
    time_s = SAMPLE_S * np.arange(1001, dtype=np.float64)
    angle = 4.0 * (parameters.a + parameters.b) / 20.0**2
    manoeuvre = Manoeuvre(20.0, angle * np.sin(np.pi * time_s))
    wanted = drive_oracle(manoeuvre, parameters).yaw_rate_radps
    derivative = right_hand_side(manoeuvre, parameters, exact_steering=False)
    start = np.array(init_mb([0.0, 0.0, 0.0, manoeuvre.speed_mps, 0.0, 0.0, 0.0], parameters))

    def fixed_steps(step_s: float) -> FloatArray:
        return _runge_kutta(derivative, start, len(time_s), step_s)

    ways: list[tuple[str, Callable[[], FloatArray]]] = [
        (DOCUMENTED, lambda: odeint(derivative, start, time_s)),
        ("odeint, tolerances 1e-3", lambda: odeint(derivative, start, time_s, rtol=1e-3, atol=1e-3)),
        ("Runge-Kutta of fourth order, 2 ms", lambda: fixed_steps(0.002)),
        ("Runge-Kutta of fourth order, 5 ms", lambda: fixed_steps(0.005)),
    ]
    found = []
    for word, solve in ways:
        started_s = time.process_time()
        yaw = solve()[:, YAW_RATE]
        cpu_s = time.process_time() - started_s
        error = float(np.abs(yaw - wanted).max() / np.abs(wanted).max())
        found.append(OracleSpeed(word, float(time_s[-1]) / cpu_s, error))
    return found


def our_speed(*, runs_count: int) -> float:
    """Return simulated seconds per CPU second of whole drives: the best of some rounds.

    Args:
        runs_count: Drives per road and sensor grade.
    """
    warm_up()
    return max(
        overall_speed_ratio([speed_of(road, grade, runs_count=runs_count) for road in ROADS for grade in SensorGrade])
        for _ in range(ROUNDS_COUNT)
    )


def paper_design_minutes(folder: Path) -> float | None:
    """Return how long the paper's design took, 44,000 kept runs simulated and summarised; None before anybody ran it.

    The slowest of its data sets with prudent drivers, the headline; reacting ones need several times as many attempts.

    Args:
        folder: Where the table of its cells lies.
    """
    table = folder / "paper_design.json"
    if not table.is_file():
        return None
    designs = json.loads(table.read_text(encoding="utf-8"))["designs"]
    slowest_s: float = max(design["wall_s"] for design in designs if design["driver_kind"] == "prudent")
    return round(slowest_s / 60.0, 2)


def main() -> None:
    """Print the table and keep the figures."""
    parser = parser_of(__doc__, results_name="speed.json")
    parser.set_defaults(out=RESULTS_FOLDER / "speed.json")
    parser.add_argument("--runs", type=int, default=160, help="drives per road and sensor grade")
    arguments = parser.parse_args()
    ours = our_speed(runs_count=arguments.runs)
    print(f"ours: {ours:.0f} simulated seconds per CPU second, everything on")
    rows: list[dict[str, str | float]] = [
        {
            "oracle solved by": speed.solver,
            "simulated s per CPU s": speed.sim_seconds_per_cpu_second,
            "ours over it": ours / speed.sim_seconds_per_cpu_second,
            "its error of the yaw rate": speed.yaw_rate_error_ratio,
        }
        for speed in oracle_speed()
    ]
    print(table_of(rows, number_format=".3g"))
    minutes = paper_design_minutes(arguments.out.parent)
    print(f"the paper's design: {'not run yet' if minutes is None else f'{minutes:.1f} minutes on two cores'}")
    keep_figures(
        arguments.out,
        {
            "sim_seconds_per_wall_second_per_core": round(ours),
            "times_commonroad": round(float(rows[0]["ours over it"])),
            "paper_design_minutes": minutes,
            "context": {
                "command": "python -m bench.simulator_speed",
                "machine": f"{platform.machine()}, {processor()}",
                "versions": {
                    name: importlib.metadata.version(name)
                    for name in ("numba", "numpy", "scipy", "commonroad-vehicle-models")
                }
                | {"python": platform.python_version()},
                "simulator": compiled_cache_key(),
                "step_s": STEP_S,
                "clock": "CPU time of the process; one thread",
                "commonroad": [{key: _rounded(value) for key, value in row.items()} for row in rows],
            },
        },
    )


def _rounded(value: str | float) -> str | float:
    return value if isinstance(value, str) else float(f"{value:.3g}")


def _runge_kutta(
    derivative: Callable[[FloatArray, float], list[float]], start: FloatArray, samples_count: int, step_s: float
) -> FloatArray:
    substeps = round(SAMPLE_S / step_s)
    states = np.empty((samples_count, len(start)))
    state = states[0] = start
    for k in range(samples_count - 1):
        for j in range(substeps):
            at = k * SAMPLE_S + j * step_s
            one = np.array(derivative(state.copy(), at))
            two = np.array(derivative(state + 0.5 * step_s * one, at + 0.5 * step_s))
            three = np.array(derivative(state + 0.5 * step_s * two, at + 0.5 * step_s))
            four = np.array(derivative(state + step_s * three, at + step_s))
            state = state + step_s / 6.0 * (one + 2.0 * two + 2.0 * three + four)
        states[k + 1] = state
    return states


if __name__ == "__main__":
    main()
