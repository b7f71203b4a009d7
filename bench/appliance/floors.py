"""What the parts of a passage cost at the very least: a datagram, a request, a run of the model, a row on the disk."""

from __future__ import annotations

import sqlite3
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.appliance.http_load import ask, get
from bench.appliance.load import PACE_PER_S
from bench.appliance.passages import DEFAULT_BUNDLE, default_manifest, draw_batch, golden_drives
from bench.appliance.processes import cpu_s, running, wait_until
from bench.appliance.rsu import serving
from bench.appliance.udp_load import ACCEPTED, Line, exchange, line_to
from bench.measurement import cost_s
from roadgrip.features import NEWEST_TABLE
from rsu_app.adapters.store.connection import apply_writer_pragmas

ROWS_PER_COMMIT_COUNT = 100
ROWS_TOGETHER_COUNT = 64
ECHOES_OUTSTANDING_COUNT = 200
BARE_TIMES = 4
"""The barest server takes some times as many passages in a turn, or processor time would be told too coarsely."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How long the floors are measured.

    Attributes:
        echoes_count: Datagrams.
        requests_count: Requests.
        commits_count: Commits.
        turn_count: Passages that the unit is sent in one turn beside the barest server.
        turns_count: Such turns.
        paced_turns_count: Turns at a steady pace, where latency and the cost of small batches show.
        paced_s: Length of each.
        model_s: For the model, each way.
    """

    echoes_count: int = 120_000
    requests_count: int = 30_000
    commits_count: int = 400
    turn_count: int = 2_000
    turns_count: int = 15
    paced_turns_count: int = 6
    paced_s: float = 3.0
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


def beside_bare(folder: Path, effort: Effort, *, rng: np.random.Generator) -> dict[str, Any]:
    """Return what a passage costs the unit and what it costs the barest server, and how late their answers are.

    In turns: with as many passages under way as make full batches, then at a steady pace.

    The speed of a rented machine changes by the second, and what it does to one server it does to the other. So the
    ratio of two costs says more than either; see `bench.appliance.floor_servers.BareUnit`.

    Args:
        folder: On the disk that databases lie on.
        effort: How many turns there are.
        rng: Draws passages.
    """
    ours, bare = folder / "unit", folder / "bare"
    ours.mkdir()
    bare.mkdir()
    with ExitStack() as stack:
        unit = stack.enter_context(serving(ours))
        process_id, port = stack.enter_context(_server("passages", bare, bare / "floor.sqlite3"))
        asked = (
            (unit.process_id, stack.enter_context(line_to(unit.host, unit.udp_port)), effort.turn_count),
            (process_id, stack.enter_context(line_to("127.0.0.1", port)), BARE_TIMES * effort.turn_count),
        )
        for _, line, count in asked:
            _cost_us(process_id, line, 2 * count, rng=rng)
        turns = [
            [_cost_us(whose, line, count, rng=rng) for whose, line, count in asked] for _ in range(effort.turns_count)
        ]
        paced = [
            [_paced(whose, line, effort.paced_s, rng=rng) for whose, line, _ in asked]
            for _ in range(effort.paced_turns_count)
        ]
    unit_us, bare_us = np.array(turns).T
    return {
        "turns_us": turns,
        "unit_us": float(np.median(unit_us)),
        "bare_us": float(np.median(bare_us)),
        "times_bare": float(np.median(unit_us / bare_us)),
        "unit_at_its_best_us": float(unit_us.min()),
        "bare_at_its_best_us": float(bare_us.min()),
        "paced": {
            "rate_per_s": PACE_PER_S,
            "turns": paced,
            **{
                f"{name}_{figure}": float(np.median([turn[place][figure] for turn in paced]))
                for place, name in enumerate(("unit", "bare"))
                for figure in paced[0][place]
            },
        },
    }


def _paced(process_id: int, line: Line, duration_s: float, *, rng: np.random.Generator) -> dict[str, float]:
    batch = draw_batch(int(PACE_PER_S * duration_s), rng=rng)
    frames, began_s = batch.frames(), cpu_s(process_id)
    done = exchange(line, frames, batch.tag, rate_per_s=PACE_PER_S)
    took_ms = 1e3 * done.latency_s
    return {
        "us": 1e6 * (cpu_s(process_id) - began_s) / done.count(ACCEPTED),
        "latency_q50_ms": float(np.quantile(took_ms, 0.5)),
        "latency_q99_ms": float(np.quantile(took_ms, 0.99)),
    }


def _cost_us(process_id: int, line: Line, passages_count: int, *, rng: np.random.Generator) -> float:
    batch = draw_batch(passages_count, rng=rng)
    frames, began_s = batch.frames(), cpu_s(process_id)
    done = exchange(line, frames, batch.tag, outstanding_count=ECHOES_OUTSTANDING_COUNT)
    return 1e6 * (cpu_s(process_id) - began_s) / done.count(ACCEPTED)


@contextmanager
def _server(kind: str, folder: Path, *arguments: Path) -> Iterator[tuple[int, int]]:
    """Give the process id and the port of a server that does next to nothing."""
    log = folder / f"floor-{kind}.log"
    log.write_bytes(b"")
    with running([sys.executable, "-m", "bench.appliance.floor_servers", kind, *arguments], log=log) as process:
        wait_until(lambda: log.read_bytes().endswith(b"\n"), process, log=log, limit_s=30.0)
        yield process.pid, int(log.read_text(encoding="ascii"))


def _datagram_us(folder: Path, effort: Effort, *, rng: np.random.Generator) -> float:
    with _server("datagrams", folder) as (process_id, port), line_to("127.0.0.1", port) as line:
        _cost_us(process_id, line, effort.echoes_count // 10, rng=rng)
        return _cost_us(process_id, line, effort.echoes_count, rng=rng)


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
