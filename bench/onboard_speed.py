"""What the onboard client costs a car: time per passage, memory, disk, and the same steps written in other ways.

python bench/onboard_speed.py                     all of it, two minutes; docs/results/onboard/speed.json and the
                                                  tables in docs/vehicle.md between their marks
python bench/onboard_speed.py --without-install   without a package index: memory as in this environment, no disk

The drives are simulated with automotive sensors. Times are CPU time of the process, the best of some rounds, so that a
busy machine shows little; ways that are compared take turns within one run. The floor is one multiplication of every
recorded sample into a new array: no estimation can be cheaper than reading its input once.
"""

from __future__ import annotations

import argparse
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

if __name__ == "__main__":
    # As a script the folder of this file is searched; the package `bench` lies beside it.
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bench.certified import VEHICLE
from bench.measurement import ROADS, cost_s, keep_figures, processor, table_of
from bench.speed import float_loop, with_scipy
from bench.speed.footprint import fresh_figures, installed, installed_mb, live_figures
from bench.speed.steps import Steps, our_grip, our_values, statistics_alone, steps_of
from roadgrip.records import Passage
from roadgrip.section import RoadSection
from roadgrip.sections import read_section
from roadgrip.units import SAMPLE_S, FloatArray
from training.marked_tables import in_four_digits, table, with_tables
from vehicle_client.estimation.trace import Trace
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.shell.codec import WireCodec
from vehicle_client.simulator.run import SensorGrade, draw_plan, simulate_passage

ROOT = Path(__file__).resolve().parents[1]
FIGURES_PATH = ROOT / "docs" / "results" / "onboard" / "speed.json"
PAGE = ROOT / "docs" / "vehicle.md"
PASSAGE_S = 40.0
"""What times are scaled to, so that roads compare."""
BASE_FRICTION_MU = 0.5
SEED = 3
ROUNDS_COUNT = 9
COMPARED_ROUNDS_COUNT = 7
TOLERANCE_RATIO = 1e-9
"""How far the other ways may differ, as a share of the signal's largest magnitude."""
FRESH_ROAD = "s-turn"


def completed_drive(section: RoadSection, *, with_gnss: bool) -> Trace:
    """Return the trace of the first drawn drive that stays on the road and that the client summarises."""
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
        if drive.completed and isinstance(summarise_passage(drive.trace, section), Summarised):
            return drive.trace
    raise RuntimeError(f"nobody came through {section.section_id}")


def summarised(trace: Trace, section: RoadSection) -> Summarised:
    """Return the summary of a drive that is known to be a passage."""
    result = summarise_passage(trace, section)
    if not isinstance(result, Summarised):
        raise RuntimeError(f"{section.section_id}: {result}")  # noqa: TRY004 - a refusal is a value, not a wrong type
    return result


def frames_of(result: Summarised, section: RoadSection) -> tuple[bytes, ...]:
    """Return the signed frames that bring a summary to the road side unit."""
    passage = Passage(bytes(range(16)), section.section_id, section.version, result.summary, 1.0)
    codec = WireCodec(passage.passage_id, section_id=section.section_id, timeout_s=5.0, signer=VEHICLE)
    return codec.frames_of(passage)


def cost_ms(work: Callable[[], object]) -> float:
    """Return the CPU time of one call."""
    return 1e3 * cost_s(work, clock=time.process_time, rounds_count=ROUNDS_COUNT, budget_s=0.15)


def passage_costs(name: str, *, with_gnss: bool) -> dict[str, str | float]:
    """Return what one passage over a road costs, from sensors to frames, and by its parts."""
    section = read_section(name)
    trace = completed_drive(section, with_gnss=with_gnss)
    result = summarised(trace, section)
    steps = steps_of(trace, section, result)
    samples = recorded(trace)
    duration_s = trace.samples_count * SAMPLE_S
    per_passage = PASSAGE_S / duration_s
    whole_ms = cost_ms(lambda: frames_of(summarised(trace, section), section)) * per_passage
    estimation_and_statistics_ms = cost_ms(lambda: our_values(steps)) * per_passage
    statistics_ms = cost_ms(lambda: statistics_alone(result.signals, steps)) * per_passage
    physical_inverse_ms = cost_ms(lambda: our_grip(steps, result.signals)) * per_passage
    frames_ms = cost_ms(lambda: frames_of(result, section))
    floor_ms = cost_ms(lambda: samples * 1.0000001) * per_passage
    return {
        "road": name,
        "matched_by": "satellites" if with_gnss else "motion",
        "trace_s": duration_s,
        "whole_ms": whole_ms,
        "checks_and_match_ms": whole_ms - estimation_and_statistics_ms - physical_inverse_ms - frames_ms,
        "estimation_ms": estimation_and_statistics_ms - statistics_ms,
        "statistics_ms": statistics_ms,
        "physical_inverse_ms": physical_inverse_ms,
        "signed_frames_ms": frames_ms,
        "floor_ms": floor_ms,
        "times_floor": whole_ms / floor_ms,
        "real_time_frac": whole_ms / (PASSAGE_S * 1e3),
    }


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


def compared(name: str) -> dict[str, str | float]:
    """Return estimation and statistics of one drive by three ways, which must give the same features.

    Raises:
        RuntimeError: They do not; then there is nothing to compare.
    """
    section = read_section(name)
    trace = completed_drive(section, with_gnss=False)
    steps = steps_of(trace, section, summarised(trace, section))
    lists = float_loop.recorded(steps)
    difference = max(
        difference_ratio(np.array(float_loop.values(lists, steps)), steps),
        difference_ratio(with_scipy.values(steps), steps),
    )
    if difference > TOLERANCE_RATIO:
        raise RuntimeError(f"{name}: the three ways differ by {difference:.1e}; their steps are not the same")
    ways: dict[str, Callable[[], object]] = {
        "ours": lambda: our_values(steps),
        "float_loop": lambda: float_loop.values(lists, steps),
        "scipy": lambda: with_scipy.values(steps),
    }
    best_ms = dict.fromkeys(ways, float("inf"))
    # In turns, so that a machine that is busy for a while is busy for all of them.
    for _ in range(COMPARED_ROUNDS_COUNT):
        for way, work in ways.items():
            once_ms = 1e3 * cost_s(work, clock=time.process_time, rounds_count=1, budget_s=0.1)
            best_ms[way] = min(best_ms[way], once_ms)
    per_passage = PASSAGE_S / (trace.samples_count * SAMPLE_S)
    return {
        "road": name,
        **{f"{way}_ms": cost * per_passage for way, cost in best_ms.items()},
        "times_float_loop": best_ms["float_loop"] / best_ms["ours"],
        "times_scipy": best_ms["scipy"] / best_ms["ours"],
        "difference_ratio": difference,
    }


def difference_ratio(values: FloatArray, steps: Steps) -> float:
    """Return the largest difference from our features, as a share of each signal's largest magnitude.

    Args:
        values: The paper's features made another way. (55,)
        steps: What they were made of.
    """
    ours, others = our_values(steps).reshape(5, -1), values.reshape(5, -1)
    # Skewness and kurtosis have no unit and are of the order of one; the rest is measured by the signal.
    in_units = np.abs(ours - others)[:, :9] / np.abs(ours[:, :9]).max(axis=1, keepdims=True)
    shapes = np.abs(ours - others)[:, 9:] / np.maximum(1.0, np.abs(ours[:, 9:]))
    return float(max(in_units.max(), shapes.max()))


def footprint(*, with_install: bool) -> dict[str, Any]:
    """Return what fresh processes take, the live client among them, and what an installation does, if one is made.

    Args:
        with_install: Whether to install the vehicle role; else processes run in this environment.
    """
    trace = completed_drive(read_section(FRESH_ROAD), with_gnss=True)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        python = installed(folder) if with_install else Path(sys.executable)
        disk = installed_mb(python) if with_install else None
        return {
            "fresh_process": fresh_figures(python, trace, FRESH_ROAD, folder),
            "live_process": live_figures(python, trace, FRESH_ROAD, folder),
            "install": disk,
        }


def page_with_tables(page: str, figures: Mapping[str, Any]) -> str:
    """Return the page with the tables of these figures.

    Args:
        page: `docs/vehicle.md`.
        figures: What `speed.json` holds.
    """
    return with_tables(page, lambda name: speed_table(figures) if name == "speed" else None)


def speed_table(figures: Mapping[str, Any]) -> str:
    """Return what a reader wants to know first."""
    fresh, live, comparison = figures["fresh_process"], figures["live_process"], figures["comparison"]
    bare_mb = fresh["interpreter_numpy_mb"]
    plainest = min(comparison, key=lambda row: float(row["times_float_loop"]))
    parts = max(figures["passages"], key=lambda row: float(row["whole_ms"]))
    rows = [
        ("40 s of driving to signed frames", "15 ms", f"{figures['passage_40s_ms']:.1f} ms"),
        ("of it checks and matching", "", f"{parts['checks_and_match_ms']:.1f} ms"),
        ("of it estimation", "", f"{parts['estimation_ms']:.1f} ms"),
        ("of it statistics", "", f"{parts['statistics_ms']:.2f} ms"),
        ("of it the physical inverse", "", f"{parts['physical_inverse_ms']:.1f} ms"),
        ("of it encoding and signing", "", f"{parts['signed_frames_ms']:.2f} ms"),
        ("reading every sample once, the floor", "", f"{parts['floor_ms']:.4f} ms"),
        (
            "estimation and statistics, sample by sample in Python floats",
            "",
            f"{figures['times_float_loop']:.0f} times ours ({plainest['float_loop_ms']:.0f} ms)",
        ),
        (
            "estimation and statistics with scipy",
            "",
            f"{figures['times_scipy']:.1f} times ours ({comparison[0]['scipy_ms']:.1f} ms)",
        ),
        (
            f"memory above interpreter and numpy ({bare_mb:.0f} MB): passages alone",
            "60 MB",
            f"{fresh['peak_mb'] - bare_mb:.0f} MB",
        ),
        ("the same: the live client with the CAN libraries", "60 MB", f"{figures['extra_memory_mb']:.0f} MB"),
        (
            "the same: and with keys to sign and believe with",
            "",
            f"{live['with_bus_and_keys_peak_mb'] - bare_mb:.0f} MB",
        ),
        (
            "installed, compiled bytecode included",
            "150 MB",
            "not measured" if figures["install"] is None else f"{figures['vehicle_install_mb']:.0f} MB",
        ),
        (
            f"importing the client, after interpreter and numpy ({fresh['interpreter_numpy_ms']:.0f} ms)",
            "",
            f"{fresh['import_ms']:.0f} ms",
        ),
        ("the first passage of a fresh process", "", f"{fresh['first_passage_ms']:.0f} ms"),
    ]
    return table(("what", "at most", "measured"), rows)


def main() -> None:
    """Measure, print, keep."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--without-install", action="store_true", help="install nothing; needs no package index")
    parser.add_argument("--out", type=Path, default=FIGURES_PATH, help="elsewhere, the page stays as it is")
    arguments = parser.parse_args()
    passages = [passage_costs(name, with_gnss=with_gnss) for name in ROADS for with_gnss in (False, True)]
    print(f"per {PASSAGE_S:.0f} s of recording ({platform.machine()}, numpy {np.__version__})\n")
    print(table_of(passages, number_format=".3g"))
    comparison = sorted((compared(name) for name in ROADS), key=lambda row: float(row["times_scipy"]))
    print(table_of(comparison, number_format=".3g"))
    taken = footprint(with_install=not arguments.without_install)
    fresh, live, disk = taken["fresh_process"], taken["live_process"], taken["install"]
    figures = in_four_digits(
        {
            "passage_40s_ms": max(float(row["whole_ms"]) for row in passages),
            "times_float_loop": min(float(row["times_float_loop"]) for row in comparison),
            "times_scipy": min(float(row["times_scipy"]) for row in comparison),
            "extra_memory_mb": live["with_bus_peak_mb"] - fresh["interpreter_numpy_mb"],
            "vehicle_install_mb": None if disk is None else disk["all_mb"],
            "passages": passages,
            "comparison": comparison,
            **taken,
            "context": {
                "command": "python bench/onboard_speed.py",
                "clock": "CPU time of the process, best of rounds; times per 40 s of recording, the dearest road",
                "comparison": "estimation and statistics only, the same steps: the least favourable road; "
                f"features agree to {TOLERANCE_RATIO:.0e} of each signal's largest magnitude",
                "memory": "peak of the live client that plays a recording, python-can and cantools loaded, above a "
                "process that imports numpy; 1 MB is 10^6 bytes",
                "machine": f"{platform.machine()}, {processor()}",
                "versions": {"python": platform.python_version(), "numpy": np.__version__},
            },
        }
    )
    print(speed_table(figures))
    keep_figures(arguments.out, figures)
    if arguments.out == FIGURES_PATH:
        PAGE.write_text(page_with_tables(PAGE.read_text(encoding="utf-8"), figures), encoding="utf-8")


if __name__ == "__main__":
    main()
