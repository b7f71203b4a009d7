"""A short soak: the client ends whole, sends within its budget, and holds no more than it says."""

import asyncio
from pathlib import Path

import pytest

from bench.live_soak import SPOOL_CAPACITY_COUNT, draw, soak
from roadgrip.records import VEHICLE_FRAME_BUDGET
from vehicle_client.mapmatch.surroundings import PASSES_LIMIT_COUNT
from vehicle_client.shell.live.ring import SampleRing

pytestmark = [pytest.mark.sim, pytest.mark.system, pytest.mark.long, pytest.mark.timeout(300)]


def test_a_quarter_of_an_hour_in_bad_air_leaves_nothing_behind(tmp_path: Path):
    figures = asyncio.run(soak(tmp_path, duration_s=900.0))
    assert figures["exit_code"] == 0
    assert figures["failures_count"] == 0
    assert figures["endings"]["accepted"] >= 1
    on_time_count = sum(count for ending, count in figures["endings"].items() if not ending.startswith("late_"))
    assert on_time_count <= figures["drives_count"]
    assert figures["most_frames_of_a_passage_count"] <= VEHICLE_FRAME_BUDGET
    # What is on its way takes no room, and no more is than passes may be open.
    assert figures["spool_most_count"] <= SPOOL_CAPACITY_COUNT + PASSES_LIMIT_COUNT
    assert figures["ring_most_mb"] <= SampleRing().limit_bytes / 1e6
    assert figures["files_count"]["end"] <= figures["files_count"]["settled"] + 2
    assert figures["counters"]["passages_open"] == 0
    assert (tmp_path / draw(figures, tmp_path)).stat().st_size > 1_000
