"""kill -9 and power cuts at every step of a rollout: a verified model runs, and what was begun can be finished."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tests.repositories import SignedRepository, make_small_bundle

ROOT = Path(__file__).resolve().parents[4]
MEMORY = Path("/dev/shm")  # noqa: S108 - a folder of its own is made there
"""Where files are only in memory: thousands of writes to a disk would take minutes and show nothing more."""


@pytest.fixture
def repositories(tmp_path):
    """Return a folder with the repository after each of three releases; the third brings the first one's bundle."""
    folder = tmp_path / "repositories"
    repository = SignedRepository(tmp_path / "laboratory")
    for number, bias_mu in ((1, 0.5), (2, 0.6), (3, 0.5)):
        make_small_bundle(tmp_path / f"bundle-{number}", bias_mu=bias_mu)
        repository.release(tmp_path / f"bundle-{number}", sequence_number=number)
        shutil.copytree(repository.folder, folder / str(number))
    (folder / "trusted-root.json").write_bytes(repository.trusted_root)
    return folder


def end_at_every_step(repositories, end):
    """Return how often a unit was ended."""
    command = [sys.executable, "-m", "tests.rsu_app.adapters.updates.update_until_killed"]
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as folder:
        run = subprocess.run(
            [*command, str(repositories), folder, end], cwd=ROOT, capture_output=True, text=True, check=False
        )
    assert run.returncode == 0, run.stderr
    found = re.fullmatch(r"ended (\d+) times, (\d+) states\n", run.stdout)
    assert found
    # Nothing at first, then three releases that are installed, switched to, and confirmed or rolled back.
    assert int(found[2]) == 1 + 3 * 3
    return int(found[1])


@pytest.mark.system
def test_a_unit_that_ends_at_any_step_of_a_rollout_runs_a_verified_model_and_finishes_later(repositories):
    # Killed before a call, and without power after it. Fewer would mean that steps were not seen.
    assert end_at_every_step(repositories, "in turn") > 300


@pytest.mark.system
@pytest.mark.long
@pytest.mark.parametrize("end", ["kill", "power cut"])
def test_so_does_one_that_ends_before_and_after_every_call(repositories, end):
    assert end_at_every_step(repositories, end) > 300
