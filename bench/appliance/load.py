"""The daemon under load: passages over UDP and HTTP, reads, ten times too much, and the way back."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.appliance.http_load import CONNECTIONS_COUNT, Answers, ask, get, is_ok, post
from bench.appliance.passages import Batch, draw_batch
from bench.appliance.rsu import Unit, serving
from bench.appliance.udp_load import (
    ACCEPTED,
    REJECTED,
    SOURCES_COUNT,
    UNANSWERED,
    Exchange,
    Line,
    exchange,
    line_to,
    verdict_of,
)
from bench.measurement import ROADS

OUTSTANDING_COUNT = 200
"""Passages without a receipt at one time when the unit sets the pace; fewer than it takes into work."""
PACE_PER_S = 1_000.0
OVERLOAD_TIMES = 10.0
LATENCY_LIMIT_S = 0.025
BIN_S = 0.25
REST_S = 20.0
"""How long what a flood left behind may take at most."""
FRAMES_MEDIA_TYPE = "application/vnd.roadgrip.frames"
WINDOW_BEFORE_READS_COUNT = 1_000


@dataclass(frozen=True, slots=True)
class Effort:
    """How long is measured.

    Attributes:
        warm_count: Passages or requests before each measurement.
        measured_s: Each way in, at its own pace.
        paced_s: At `PACE_PER_S`.
        overload_s: Ten times what the unit takes.
        after_s: At `PACE_PER_S` again.
    """

    warm_count: int = 3_000
    measured_s: float = 12.0
    paced_s: float = 12.0
    overload_s: float = 4.0
    after_s: float = 8.0


def over_udp(folder: Path, effort: Effort, *, rng: np.random.Generator) -> dict[str, Any]:
    """Return how many passages the unit takes over UDP, how soon it answers, and what too many do to it."""
    with serving(folder) as unit, line_to(unit.host, unit.udp_port) as line:
        taken = _at_its_own_pace(unit, line, effort, rng=rng)
        paced = _paced(line, rate_per_s=PACE_PER_S, duration_s=effort.paced_s, rng=rng)
        figures = {**taken, "sources_count": SOURCES_COUNT, "paced": _latency_figures(paced)}
        figures["overload"] = _overload(
            unit, line, effort, taken_per_s=taken["passages_per_s"], usual_s=usual_s(paced), rng=rng
        )
    return figures


def over_udp_signed(folder: Path, effort: Effort, *, rng: np.random.Generator) -> dict[str, Any]:
    """Return how many signed passages the unit takes when it requires signatures and signs what it says."""
    from bench.appliance.signed import Vehicles, signed_settings

    vehicles = Vehicles.issued(rng=rng)
    settings = signed_settings(folder, vehicles)
    with serving(folder, settings) as unit, line_to(unit.host, unit.udp_port) as line:
        strangers = _at_its_own_pace(
            unit, line, effort, rng=rng, frames_of=vehicles.frames_of, warm_count=100, limit_count=len(vehicles.signers)
        )
        known = _at_its_own_pace(
            unit, line, effort, rng=rng, frames_of=vehicles.frames_of, warm_count=len(vehicles.signers)
        )
        return {**known, "certificates_count": len(vehicles.signers), "certificate_never_seen": strangers}


def over_http(folder: Path, effort: Effort, *, rng: np.random.Generator) -> dict[str, Any]:
    """Return how many passages the unit takes over HTTP, as frames and as JSON, and how many reads it answers."""
    with serving(folder) as unit:
        figures: dict[str, Any] = {"connections_count": CONNECTIONS_COUNT}
        figures["frames"] = _asked(unit, effort, lambda n: frame_requests(n, rng=rng), is_good=holds_receipt)
        figures["json"] = _asked(unit, effort, lambda n: json_requests(n, rng=rng))
        for name in ("advisory", "map"):
            figures[name] = _asked(unit, effort, lambda n, name=name: _reads((name,), n))  # type: ignore[misc]
        figures["reads"] = _asked(unit, effort, lambda n: _reads(("advisory", "map"), n))
        return figures


def _at_its_own_pace(
    unit: Unit,
    line: Line,
    effort: Effort,
    *,
    rng: np.random.Generator,
    frames_of: Callable[[Batch], Sequence[bytes]] = Batch.frames,
    warm_count: int | None = None,
    limit_count: int | None = None,
) -> dict[str, Any]:
    warming = draw_batch(warm_count or effort.warm_count, rng=rng)
    warmed = exchange(line, frames_of(warming), warming.tag, outstanding_count=OUTSTANDING_COUNT)
    wanted_count = max(200, int(warmed.accepted_per_s * effort.measured_s))
    batch = draw_batch(min(wanted_count, limit_count or wanted_count), rng=rng)
    frames = frames_of(batch)
    began_cpu_s, began_own_s = unit.cpu_s, time.process_time()
    done = exchange(line, frames, batch.tag, outstanding_count=OUTSTANDING_COUNT)
    took_cpu_s = unit.cpu_s - began_cpu_s
    return {
        "passages_per_s_per_core": _ratio(done.count(ACCEPTED), took_cpu_s),
        "passages_per_s": done.accepted_per_s,
        "cpu_us_per_passage": 1e6 * _ratio(took_cpu_s, done.count(ACCEPTED)),
        **_verdicts(done),
        "frame_bytes": len(frames[0]),
        "outstanding_count": OUTSTANDING_COUNT,
        "loading_core_busy_frac": _ratio(time.process_time() - began_own_s, done.ended_s - float(done.sent_s[0])),
    }


def _paced(line: Line, *, rate_per_s: float, duration_s: float, rng: np.random.Generator) -> Exchange:
    batch = draw_batch(int(rate_per_s * duration_s), rng=rng)
    return exchange(line, batch.frames(), batch.tag, rate_per_s=rate_per_s)


def _latency_figures(done: Exchange) -> dict[str, Any]:
    return {
        "rate_per_s": PACE_PER_S,
        "latency_q50_ms": _quantile_ms(done.latency_s, 0.5),
        "latency_q99_ms": _quantile_ms(done.latency_s, 0.99),
        "latency_max_ms": _quantile_ms(done.latency_s, 1.0),
        "sent_late_q99_ms": _quantile_ms(done.sent_s - done.due_s, 0.99),
        **_verdicts(done),
    }


def _overload(
    unit: Unit, line: Line, effort: Effort, *, taken_per_s: float, usual_s: float, rng: np.random.Generator
) -> dict[str, Any]:
    """Return what ten times too much leads to, and how long it is felt.

    Recovered is what accepts everything as soon as it usually does. Where that is later than the latency asked for,
    the overload is not to blame; from when on that one is kept is told, too.
    """
    rate_per_s = OVERLOAD_TIMES * taken_per_s
    flood = draw_batch(max(1, int(rate_per_s * effort.overload_s)), rng=rng)
    after = draw_batch(int(PACE_PER_S * effort.after_s), rng=rng)
    flood_frames, after_frames = flood.frames(), after.frames()
    before, dropped_before_count, before_mb = _counted(unit), unit.kernel_drops_count(), unit.resident_mb
    done = exchange(line, flood_frames, flood.tag, rate_per_s=rate_per_s, silence_s=0.0)
    highest_mb = unit.resident_mb
    back = exchange(line, after_frames, after.tag, rate_per_s=PACE_PER_S)
    counted = {name: now - before[name] for name, now in _counted_at_rest(unit).items()}
    dropped_count = unit.kernel_drops_count() - dropped_before_count
    sent_count = len(flood_frames) + len(after_frames)
    flood_s = float(done.sent_s[-1] - done.sent_s[0])
    return {
        "offered_per_s": len(flood_frames) / flood_s,
        "offered_times": _ratio(len(flood_frames) / flood_s, taken_per_s),
        "duration_s": flood_s,
        **_verdicts(done),
        "accepted_per_s": done.count(ACCEPTED) / flood_s,
        "kernel_dropped_count": dropped_count,
        "server_counted": counted,
        "unaccounted_count": sent_count - dropped_count - counted["frames_received_count"],
        "resident_before_mb": before_mb,
        "resident_after_mb": highest_mb,
        "after": {
            **_latency_figures(back),
            "usual_ms": 1e3 * usual_s,
            "recovered_after_s": recovered_after_s(back, limit_s=max(usual_s, LATENCY_LIMIT_S)),
            "in_time_after_s": recovered_after_s(back, limit_s=LATENCY_LIMIT_S),
        },
        "timeline": timeline(back),
    }


def _counted_at_rest(unit: Unit) -> dict[str, int]:
    """Return the counters as soon as they stand still: nothing waits in the unit's socket any more."""
    give_up_s = time.monotonic() + REST_S
    before: dict[str, int] = {}
    now = _counted(unit)
    while now != before and time.monotonic() < give_up_s:
        time.sleep(BIN_S)
        before, now = now, _counted(unit)
    return now


def _counted(unit: Unit) -> dict[str, int]:
    names = {
        "frames_received_count": ("roadgrip_frames_received_total", {"via": "udp"}),
        "frames_dropped_count": ("roadgrip_frames_dropped_total", {"via": "udp"}),
        "refused_busy_count": ("roadgrip_passages_total", {"via": "udp", "reason": "busy"}),
        "refused_otherwise_count": ("roadgrip_passages_total", {"via": "udp", "outcome": "rejected"}),
        "accepted_count": ("roadgrip_passages_total", {"via": "udp", "outcome": "counted"}),
        "uncounted_count": ("roadgrip_passages_total", {"via": "udp", "outcome": "uncounted"}),
    }
    values = unit.metrics_sum(tuple(names.values()))
    counted = {name: int(value) for name, value in zip(names, values, strict=True)}
    counted["refused_otherwise_count"] -= counted["refused_busy_count"]
    counted["accepted_count"] += counted.pop("uncounted_count")
    return counted


def timeline(done: Exchange) -> list[dict[str, float | None]]:
    """Return, for each `BIN_S` of sending, the share that was accepted and how late their receipts were."""
    bins = ((done.due_s - done.due_s[0]) / BIN_S).astype(np.intp)
    rows: list[dict[str, float | None]] = []
    for number in range(int(bins[-1]) + 1):
        inside = bins == number
        accepted = inside & (done.verdicts == ACCEPTED)
        took_s = done.answered_s[accepted] - done.sent_s[accepted]
        rows.append(
            {
                "from_s": number * BIN_S,
                "accepted_frac": float(accepted.sum() / inside.sum()),
                "latency_q99_ms": _quantile_ms(took_s, 0.99),
            }
        )
    return rows


def usual_s(done: Exchange) -> float:
    """Return how late receipts are in the slowest `BIN_S` of an ordinary time, as `recovered_after_s` looks at them."""
    return 1e-3 * max((row["latency_q99_ms"] for row in timeline(done) if row["latency_q99_ms"] is not None), default=0)


def recovered_after_s(done: Exchange, *, limit_s: float) -> float | None:
    """Return from when on every passage was accepted and 99 % of them in time; None if that never lasted.

    Args:
        done: What was sent after the overload, at a pace that the unit can bear.
        limit_s: What is in time.
    """
    good = [
        row["accepted_frac"] == 1.0 and row["latency_q99_ms"] is not None and row["latency_q99_ms"] <= 1e3 * limit_s
        for row in timeline(done)
    ]
    last_bad = max((number for number, is_good in enumerate(good) if not is_good), default=-1)
    return None if last_bad == len(good) - 1 else (last_bad + 1) * BIN_S


def _asked(
    unit: Unit,
    effort: Effort,
    requests_of: Callable[[int], list[bytes]],
    *,
    is_good: Callable[[bytes], bool] = is_ok,
) -> dict[str, Any]:
    warmed = ask(unit.host, unit.http_port, requests_of(effort.warm_count // 4), is_good=is_good)
    requests = requests_of(max(200, int(warmed.good_per_s * effort.measured_s)))
    began_cpu_s, began_own_s = unit.cpu_s, time.process_time()
    done = ask(unit.host, unit.http_port, requests, is_good=is_good)
    return request_figures(
        done, cpu_s=unit.cpu_s - began_cpu_s, loading_s=time.process_time() - began_own_s, request=requests[0]
    )


def request_figures(done: Answers, *, cpu_s: float, loading_s: float, request: bytes) -> dict[str, Any]:
    """Return the figures of a run of requests.

    Args:
        done: What became of them.
        cpu_s: What they cost the server.
        loading_s: What they cost who asked.
        request: One of them.
    """
    return {
        "requests_per_s_per_core": _ratio(done.good_count, cpu_s),
        "requests_per_s": done.good_per_s,
        "cpu_us_per_request": 1e6 * _ratio(cpu_s, done.good_count),
        "latency_q50_ms": _quantile_ms(done.took_s[done.good], 0.5),
        "latency_q99_ms": _quantile_ms(done.took_s[done.good], 0.99),
        "good_count": done.good_count,
        "bad_count": len(done.good) - done.good_count,
        "first_bad": done.first_bad[:300].decode(errors="replace"),
        "request_bytes": len(request),
        "loading_core_busy_frac": _ratio(loading_s, done.ended_s - done.began_s),
    }


def frame_requests(count: int, *, rng: np.random.Generator) -> list[bytes]:
    """Return requests that each bring a new passage as the frame of the radio."""
    return [post("/v1/frames", frame, media_type=FRAMES_MEDIA_TYPE) for frame in draw_batch(count, rng=rng).frames()]


def json_requests(count: int, *, rng: np.random.Generator) -> list[bytes]:
    """Return requests that each bring a new passage as JSON."""
    return [
        post(f"/v1/sections/{section_id}/passages", body, media_type="application/json")
        for section_id, body in draw_batch(count, rng=rng).json_bodies()
    ]


def _reads(names: tuple[str, ...], count: int) -> list[bytes]:
    paths = [f"/v1/sections/{section}/{name}" for section in ROADS for name in names]
    return [get(paths[number % len(paths)]) for number in range(count)]


def holds_receipt(answer: bytes) -> bool:
    """Return whether the one frame in the body is the receipt of an accepted passage."""
    with suppress(IndexError):
        return is_ok(answer) and verdict_of(answer.partition(b"\r\n\r\n")[2]) == ACCEPTED
    return False


def _verdicts(done: Exchange) -> dict[str, int]:
    return {
        "sent_count": len(done.verdicts),
        "accepted_count": done.count(ACCEPTED),
        "rejected_count": done.count(REJECTED),
        "unanswered_count": done.count(UNANSWERED),
    }


def _quantile_ms(values_s: np.ndarray[Any, np.dtype[np.float64]], share: float) -> float | None:
    return 1e3 * float(np.quantile(values_s, share)) if len(values_s) else None


def _ratio(one: float, other: float) -> float:
    return one / other if other > 0.0 else 0.0
