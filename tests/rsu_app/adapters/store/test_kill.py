"""kill -9 in the middle of ingest: whatever was acknowledged is in the database."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
import sys
from pathlib import Path

import pytest

from rsu_app.adapters.store import open_store
from rsu_app.adapters.store.recovery import damage

ROOT = Path(__file__).resolve().parents[4]


def ingest_and_kill(database_path, *, first_number, acknowledged_count, wait_s):
    """Return the ids that were acknowledged before the kill: so many at least, and what came while we waited."""
    command = [sys.executable, "-m", "tests.rsu_app.adapters.store.ingest_until_killed"]
    with subprocess.Popen(
        [*command, str(database_path), str(first_number)], stdout=subprocess.PIPE, cwd=ROOT
    ) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(acknowledged_count)]
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(wait_s)
        process.kill()
        lines += process.stdout.readlines()
    # Only a line that ends was acknowledged.
    return {bytes.fromhex(line.decode()) for line in lines if line.endswith(b"\n")}


def stored_ids(database_path):
    async def story():
        store = open_store(database_path)
        loaded = await store.load(since_unix_s=0.0, limit_count=1_000_000)
        await store.close()
        return [passage.estimate.passage_id for passage in loaded]

    return asyncio.run(story())


def survive(database_path, rng, *, rounds_count):
    acknowledged: set[bytes] = set()
    for number in range(rounds_count):
        acknowledged |= ingest_and_kill(
            database_path,
            first_number=20_000 * number,
            acknowledged_count=int(rng.integers(200, 1000)),
            wait_s=float(rng.uniform(0.0, 0.02)),
        )
        assert damage(database_path) is None
        stored = stored_ids(database_path)
        assert acknowledged <= set(stored)
        assert len(stored) == len(set(stored))
    assert len(acknowledged) >= 200 * rounds_count


@pytest.mark.system
def test_no_acknowledged_passage_is_lost(tmp_path, rng):
    survive(tmp_path / "passages.db", rng, rounds_count=2)


@pytest.mark.system
@pytest.mark.long
def test_no_acknowledged_passage_is_lost_however_often(tmp_path, rng):
    survive(tmp_path / "passages.db", rng, rounds_count=40)
