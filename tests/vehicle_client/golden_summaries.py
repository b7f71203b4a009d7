"""Golden summaries: what the onboard client makes of fixed drives, as a table a person can compare.

``python -m tests.vehicle_client.golden_summaries`` writes the table anew; a change of behaviour is then a diff of
`tests/golden/onboard/summaries.csv`. The first drive is synthetic and needs numpy alone; the others are simulated on
the paper's roads with grip to spare, where no intervention turns a last bit into another drive.
"""

import csv
import io
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from roadgrip.features import NEWEST_TABLE
from roadgrip.sections import read_section
from tests.vehicle_client.synthetic import drive_over, road, s_turn, with_noise
from vehicle_client.pipeline import Summarised, summarise_passage

PATH = Path(__file__).resolve().parents[1] / "golden" / "onboard" / "summaries.csv"
SYNTHETIC = "synthetic"
SIMULATED = ("long-turn", "s-turn", "sharp-turn")
BASE_FRICTION_MU = 0.7
SEED = 7


def summary_values(drive: str) -> tuple[float, ...]:
    """Return the numbers that the onboard client makes of a fixed drive, in the order of the newest table."""
    if drive == SYNTHETIC:
        section = road(s_turn, cross_slope_ratio=0.03)
        trace, _ = drive_over(s_turn, swing_mps=2.0, tilt_rad=float(np.arctan(0.03)))
        trace = with_noise(trace, np.random.default_rng(SEED))
    else:
        # Compiled code: only who asks for a simulated drive needs the compiler.
        from vehicle_client.simulator.run import SensorGrade, draw_plan, simulate_passage

        section = read_section(drive)
        plan = draw_plan(
            np.random.default_rng(SEED),
            section=section,
            base_friction_mu=BASE_FRICTION_MU,
            grade=SensorGrade.AUTOMOTIVE,
            with_gnss=True,
        )
        trace = simulate_passage(section, plan).trace
    result = summarise_passage(trace, section)
    assert isinstance(result, Summarised), result
    return result.summary.values


def written(drives: Iterable[str]) -> str:
    """Return the table: one row per feature, one column per drive."""
    drives = tuple(drives)
    columns = [summary_values(drive) for drive in drives]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["feature", *drives])
    for i, feature in enumerate(NEWEST_TABLE.kinematic):
        writer.writerow([feature.name, *(f"{column[i]:.6g}" for column in columns)])
    return text.getvalue()


def golden_values(drive: str) -> dict[str, float]:
    """Return what the table says about a drive, by feature."""
    with PATH.open(encoding="utf-8", newline="") as file:
        return {row["feature"]: float(row[drive]) for row in csv.DictReader(file)}


if __name__ == "__main__":
    PATH.parent.mkdir(parents=True, exist_ok=True)
    PATH.write_text(written((SYNTHETIC, *SIMULATED)), encoding="utf-8")
