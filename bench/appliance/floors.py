"""What the parts of a passage cost at the very least: a datagram, a request, a run of the model, a row on the disk."""

from __future__ import annotations

import sqlite3
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.appliance.http_load import ask, get
from bench.appliance.passages import DEFAULT_BUNDLE, default_manifest, draw_batch, golden_drives
from bench.appliance.processes import cpu_s, running, wait_until
from bench.appliance.udp_load import ACCEPTED, exchange, line_to
from bench.measurement import cost_s
from roadgrip.features import NEWEST_TABLE
from rsu_app.adapters.store.connection import apply_writer_pragmas

ROWS_PER_COMMIT_COUNT = 100
ROWS_TOGETHER_COUNT = 64
ECHOES_OUTSTANDING_COUNT = 200


@dataclass(frozen=True, slots=True)
class Effort:
    """How long the floors are measured.

    Attributes:
        echoes_count: Datagrams.
        requests_count: Requests.
        commits_count: Commits.
        model_s: For the model, each way.
    """

    echoes_count: int = 120_000
    requests_count: int = 30_000
    commits_count: int = 400
    model_s: float = 1.0


def floors(folder: Path, effort: Effort, *, rng: np.random.Generator) -> dict[str, Any]:
    """Return what each part costs by itself, in microseconds of processor time.

    Args:
        folder: On the disk that databases lie on.
        effort: How long is measured.
        rng: Draws passages.
    """
    return {
        "datagram_us": _datagram_us(folder, effort, rng=rng),
        "request_us": _request_us(folder, effort),
        **_model_us(effort),
        **_commit_us(folder, effort),
    }


@contextmanager
def _server(kind: str, folder: Path) -> Iterator[tuple[int, int]]:
    """Give the process id and the port of a server that does nothing."""
    log = folder / f"floor-{kind}.log"
    log.write_bytes(b"")
    with running([sys.executable, "-m", "bench.appliance.floor_servers", kind], log=log) as process:
        wait_until(lambda: log.read_bytes().endswith(b"\n"), process, log=log, limit_s=30.0)
        yield process.pid, int(log.read_text(encoding="ascii"))


def _datagram_us(folder: Path, effort: Effort, *, rng: np.random.Generator) -> float:
    warming, batch = (draw_batch(count, rng=rng) for count in (effort.echoes_count // 10, effort.echoes_count))
    with _server("datagrams", folder) as (process_id, port), line_to("127.0.0.1", port) as line:
        exchange(line, warming.frames(), warming.tag, outstanding_count=ECHOES_OUTSTANDING_COUNT)
        frames, began_s = batch.frames(), cpu_s(process_id)
        done = exchange(line, frames, batch.tag, outstanding_count=ECHOES_OUTSTANDING_COUNT)
        return 1e6 * (cpu_s(process_id) - began_s) / done.count(ACCEPTED)


def _request_us(folder: Path, effort: Effort) -> float:
    with _server("http", folder) as (process_id, port):
        ask("127.0.0.1", port, [get("/")], requests_count=effort.requests_count // 10)
        began_s = cpu_s(process_id)
        done = ask("127.0.0.1", port, [get("/")], requests_count=effort.requests_count)
        return 1e6 * (cpu_s(process_id) - began_s) / done.good_count


def _model_us(effort: Effort) -> dict[str, float]:
    import onnxruntime

    (model,) = (model for model in default_manifest().models if model.table_digest == NEWEST_TABLE.digest)
    rows = np.asarray(model.golden.rows, dtype=np.float32)
    rows = np.tile(rows, (-(-ROWS_TOGETHER_COUNT // len(rows)), 1))[:ROWS_TOGETHER_COUNT]
    figures = {}
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    sessions = {
        name: onnxruntime.InferenceSession(DEFAULT_BUNDLE / file, options, providers=["CPUExecutionProvider"])
        for name, file in zip(("friction", "error"), model.files, strict=True)
    }
    for name, session in sessions.items():
        given = session.get_inputs()[0].name
        for count in (1, ROWS_TOGETHER_COUNT):
            run = partial(session.run, None, {given: rows[:count]})
            took_s = cost_s(run, clock=time.process_time, rounds_count=3, budget_s=effort.model_s / 3)
            figures[f"{name}_model_{count}_rows_us"] = 1e6 * took_s / count
    return figures


def _commit_us(folder: Path, effort: Effort) -> dict[str, float]:
    path, message = folder / "floor.sqlite3", golden_drives()[0].message
    database = sqlite3.connect(path, isolation_level=None)
    try:
        apply_writer_pragmas(database)
        database.execute("CREATE TABLE passages (number INTEGER PRIMARY KEY, message BLOB NOT NULL)")
        rows = [(message,)] * ROWS_PER_COMMIT_COUNT
        began_cpu_s, began_s = time.process_time(), time.perf_counter()
        for _ in range(effort.commits_count):
            database.execute("BEGIN IMMEDIATE")
            database.executemany("INSERT INTO passages (message) VALUES (?)", rows)
            database.execute("COMMIT")
        rows_count = ROWS_PER_COMMIT_COUNT * effort.commits_count
        took_cpu_s, took_s = time.process_time() - began_cpu_s, time.perf_counter() - began_s
        return {"commit_row_us": 1e6 * took_cpu_s / rows_count, "commit_rows_per_s": rows_count / took_s}
    finally:
        database.close()
