"""docs/operators.md, from the first line to the last: every command on it is run, on a small scale."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from deploy.rehearsal.traffic import Traffic, drives_of
from deploy.rehearsal.units import Unit
from deploy.rehearsal.warm import PROGRAMS, WarmPrograms
from tests.system.test_documented_commands import blocks

pytestmark = [pytest.mark.system, pytest.mark.sim, pytest.mark.timeout(900)]

SMALL = {
    "--runs 160 --random-roads 360": "--runs 2 --random-roads 14 --random-runs 1 --seed 1",
    "data holdouts --work work/holdouts": "data holdouts --work work/holdouts --runs 4 --random-roads 12",
    "roadgrip-train retrain": "roadgrip-train retrain --trees 40 --depth 5",
    "roadgrip-train gate": "roadgrip-train gate --thresholds THRESHOLDS",
    "/media/stick": "stick",
}
"""What stands on the page, and what a test has the time for."""
SERVED = {"roadgrip-rsu serve", "roadgrip-train ui"}
"""Commands that run until they are stopped: the unit is running, and the page of mlflow has a test of its own."""


class Year:
    """Runs the page line by line in one folder."""

    def __init__(self, folder: Path, root: Path, programs: WarmPrograms) -> None:
        self.folder = folder
        self._programs = programs
        self.ran: list[str] = []
        self._thresholds = root / "deploy" / "rehearsal" / "thresholds.toml"

    def run(self, line: str, *, expected: tuple[int, ...] = (0,)) -> str:
        small = line
        for said, meant in SMALL.items():
            small = small.replace(said, meant)
        small = small.replace("THRESHOLDS", str(self._thresholds))
        words = shlex.split(small)
        if words[0] in PROGRAMS:
            environment = {"ROADGRIP_CONFIG": "canary-unit/rsu.toml", "COLUMNS": "150"}
            done = self._programs.run(words, folder=self.folder, environment=environment)
        else:
            done = subprocess.run(words, cwd=self.folder, capture_output=True, text=True, check=False)
        assert done.returncode in expected, f"{small}\n{done.stdout}{done.stderr}"
        self.ran.append(line)
        return done.stdout

    def until(self, lines: list[str], last: str) -> list[str]:
        """Run the lines of the page that come before one, and return the rest."""
        place = next(i for i, line in enumerate(lines) if line.startswith(last))
        for line in lines[:place]:
            self.run(line)
        return lines[place:]


def lines_of(page: Path) -> list[str]:
    shown = "".join(block for block in blocks(page) if "[updates]" not in block)
    return [line for line in shown.replace("\\\n", " ").splitlines() if line.strip()]


@pytest.mark.long
def test_the_operator_s_year_goes_as_the_page_says(project_root, tmp_path):
    page = project_root / "docs" / "operators.md"
    lines = lines_of(page)
    with WarmPrograms() as programs:
        live_through(Year(tmp_path, project_root, programs), lines, root=project_root)


def live_through(year: Year, lines: list[str], *, root: Path) -> None:
    tmp_path = year.folder
    rest = year.until(lines, "roadgrip-rsu config check")
    year.run("roadgrip-train simulate --section long-turn --sensors automotive --runs 20 --seed 9 --out traffic")
    drives = drives_of(tmp_path / "traffic")
    unit = Unit(
        tmp_path / "canary-unit",
        ring="canary",
        factory=root / "rsu_app" / "default_bundle",
        repository=tmp_path / "lab" / "repository",
        trusted_root=tmp_path / "lab" / "repository" / "trusted-root.json",
        passages_count=10,
        # A model of a few hundred drives is far from the packaged one, which is no subject of this test.
        settings=(
            "poll_period_s = 86400.0\nmedian_limit_ratio = 1.0\nspread_limit_ratio = 3.0\nshare_limit_frac = 1.0\n"
        ),
    )
    try:
        unit.wait_until_ready()
        (tmp_path / "stick").mkdir()
        began = datetime.now(UTC)
        traffic = Traffic(unit.url, rng=unit.rng)
        waiting = iter(drives)
        stages: list[str] = []
        for line in rest:
            if line in SERVED:
                year.ran.append(line)
                continue
            if line.startswith("roadgrip-train ground-truth import"):
                trailer = tmp_path / "trailer.csv"
                span = f"{began.isoformat()},{(datetime.now(UTC)).isoformat()}"
                trailer.write_text(
                    f"section_id,from_utc,until_utc,mu,mu_sd,instrument\nlong-turn,{span},0.5,0.03,trailer 3\n"
                )
            line_now = line.replace("2026-01-31T06:00Z", (datetime.now(UTC) - timedelta(seconds=1)).isoformat())
            told = year.run(line_now)
            year.ran[-1] = line
            if line.startswith("roadgrip-rsu update"):
                # Vehicles pass, as they do between two commands of an operator: through shadow and probation.
                for _ in range(3):
                    traffic.send(next(waiting) for _ in range(15))
                    time.sleep(2.0)
            if line.startswith("roadgrip-rsu status"):
                stages.append(told)
        assert traffic.lost == []
        assert len(stages) == 2
    finally:
        unit.stop()
    assert [line for line in year.ran if "--out traffic" not in line] == lines
    acts = {row[0] for row in unit.rows("SELECT action FROM ledger")}
    assert {"live", "installed", "shadowing", "switched", "rolled_back"} <= acts
    shutil.rmtree(tmp_path / "lab")


def test_every_reason_of_a_refusal_stands_on_the_page(project_root):
    from rsu_app.rollout_ports import UpdateReason

    text = (project_root / "docs" / "operators.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `(\w+)` \|", text, flags=re.MULTILINE)) == {reason.value for reason in UpdateReason}
