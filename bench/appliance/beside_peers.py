"""The unit and others that serve the same model, in turns."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.appliance.http_load import Answers, ask, is_ok
from bench.appliance.load import OUTSTANDING_COUNT, frame_requests, holds_receipt, json_requests
from bench.appliance.passages import draw_batch
from bench.appliance.peers import HOST, PEERS, Peer, RunningPeer, not_measured, running_peer
from bench.appliance.processes import cpu_s, resident_mb
from bench.appliance.rsu import Unit, serving
from bench.appliance.udp_load import ACCEPTED, Line, exchange, line_to

WARM_COUNT = 300
TURN_COUNT_MIN = 100


@dataclass(frozen=True, slots=True)
class Effort:
    """How long is measured.

    Attributes:
        turn_s: Each way into each server, in a turn.
        turns_count: Turns.
    """

    turn_s: float = 0.8
    turns_count: int = 8


@dataclass(frozen=True, slots=True)
class _Way:
    """One way into a server.

    Attributes:
        process_id: Of the server.
        asked: Asks so many times, and returns how many were answered as they should.
    """

    process_id: int
    asked: Callable[[int], int]

    def cost_us(self, count: int) -> float:
        """Return the processor time that a request takes the server and all its children."""
        began_s = cpu_s(self.process_id)
        good_count = self.asked(count)
        return 1e6 * (cpu_s(self.process_id) - began_s) / max(1, good_count)


def beside_peers(folder: Path, effort: Effort, *, rng: np.random.Generator) -> dict[str, Any]:
    """Return what a request costs the unit and each peer, in turns, and the median of the ratios of each turn.

    All of them run for the whole time, and one is asked after the other: the speed of a rented machine changes by the
    second, and servers that were measured a minute apart were measured on two machines.

    Args:
        folder: On the disk that databases lie on.
        effort: How long is measured.
        rng: Draws passages.
    """
    bad: dict[str, int] = {}
    with ExitStack() as stack:
        unit = stack.enter_context(serving(folder))
        line = stack.enter_context(line_to(unit.host, unit.udp_port))
        ways = _ways_of_unit(unit, line, rng=rng)
        peers: dict[str, dict[str, Any]] = {}
        ready: dict[str, RunningPeer] = {}
        for peer in PEERS:
            peers[peer.key] = {"name": peer.name, "setting": peer.setting}
            try:
                ready[peer.key] = stack.enter_context(running_peer(peer, folder))
            except (RuntimeError, OSError, ValueError, subprocess.SubprocessError) as error:
                peers[peer.key]["not_measured"] = not_measured(peer, error)
                continue
            ways[peer.key] = _way_of_peer(peer, ready[peer.key], bad)
        counts = {name: _count_for(way, effort.turn_s) for name, way in ways.items()}
        turns = [{name: way.cost_us(counts[name]) for name, way in ways.items()} for _ in range(effort.turns_count)]
        for key, running in ready.items():
            peers[key] |= {
                "requests_per_s_per_core": 1e6 / _median([turn[key] for turn in turns]),
                "bad_count": bad.get(key, 0),
                "resident_mb": resident_mb(running.process_id),
                "ready_s": running.ready_s,
                "versions": dict(running.versions),
                "answers_agree": True,
            }
        ours = {name: 1e6 / _median([turn[name] for turn in turns]) for name in OUR_WAYS}
        return {
            "ours": {"per_s_per_core": ours, "resident_mb": unit.resident_mb},
            "peers": peers,
            "times": times_of(turns, ready),
            "turns_us": turns,
        }


OUR_WAYS = ("udp", "http", "http_json")


def times_of(turns: Sequence[Mapping[str, float]], keys: Iterable[str]) -> dict[str, dict[str, float]]:
    """Return how many times as much as each way into the unit each peer costs: the median of the turns.

    Args:
        turns: What a request cost by each way and with each peer, turn by turn.
        keys: The peers.
    """
    return {way: {key: _median([turn[key] / turn[way] for turn in turns]) for key in keys} for way in OUR_WAYS}


def _ways_of_unit(unit: Unit, line: Line, *, rng: np.random.Generator) -> dict[str, _Way]:
    def by_udp(count: int) -> int:
        batch = draw_batch(count, rng=rng)
        return exchange(line, batch.frames(), batch.tag, outstanding_count=OUTSTANDING_COUNT).count(ACCEPTED)

    def by_http(requests: Sequence[bytes], is_good: Callable[[bytes], bool]) -> int:
        return ask(unit.host, unit.http_port, requests, is_good=is_good).good_count

    asked = {
        "udp": by_udp,
        "http": lambda count: by_http(frame_requests(count, rng=rng), holds_receipt),
        "http_json": lambda count: by_http(json_requests(count, rng=rng), is_ok),
    }
    return {name: _Way(unit.process_id, asked[name]) for name in OUR_WAYS}


def _way_of_peer(peer: Peer, running: RunningPeer, bad: dict[str, int]) -> _Way:
    def asked(count: int) -> int:
        done: Answers = ask(HOST, running.port, running.requests, requests_count=count)
        if not done.good_count:
            raise RuntimeError(f"{peer.name} answered no request: {done.first_bad[:300]!r}")
        bad[peer.key] = bad.get(peer.key, 0) + len(done.good) - done.good_count
        return done.good_count

    return _Way(running.process_id, asked)


def _count_for(way: _Way, turn_s: float) -> int:
    return max(TURN_COUNT_MIN, int(1e6 * turn_s / max(1.0, way.cost_us(WARM_COUNT))))


def _median(values: Sequence[float]) -> float:
    return float(np.median(values))
