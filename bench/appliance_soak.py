"""A week beside the road in ten minutes: what the unit takes of its machine, and whether it takes more and more.

python -m bench.appliance_soak                 168 hours, some ten minutes on the wall (`make appliance-soak`)
python -m bench.appliance_soak --hours 12      shorter; nothing is written without --out

The real daemon with the packaged bundle and sections runs on a clock a thousand times as fast; passages are kept for
a day, so that a week holds several generations of them. Vehicles come over UDP, many by day and few by night. One frame
in a hundred has a flipped bit, one in fifty comes again, and there is rubbish that is no frame at all. Meanwhile
clients read maps and advice, listen to the event stream for a while, and leave without a word; metrics and readiness
are asked for as a monitor does. Traffic comes from a fixed seed; what of it falls into which hour depends on the
machine.

Writes docs/results/soak.json and soak.svg.
"""

from __future__ import annotations

import argparse
import json
import socket
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, pi
from pathlib import Path
from typing import Any

import numpy as np

from bench.appliance.conditions import conditions
from bench.appliance.passages import draw_batch
from bench.appliance.rsu import Unit, serving
from bench.appliance.sections import served_sections
from bench.appliance.udp_load import Line, line_to
from bench.measurement import keep_figures
from bench.validation.picture import OURS, QUIET, headroom, label, legend, line, panels, write

SEED = 20261123
SPEEDUP_RATIO = 1_000.0
HOUR_S, DAY_HOURS = 3_600.0, 24.0
NIGHT_PER_HOUR, DAY_PER_HOUR = 20.0, 180.0
"""Vehicles over all sections, at four in the night and in the afternoon."""
SPOILED_FRAC, REPEATED_FRAC, RUBBISH_FRAC = 0.01, 0.02, 0.01
STEP_S, SAMPLE_S, MONITOR_S, READERS_S = 0.2, 1.0, 3.0, 1.5
SETTLED_HOURS = 36.0
"""From here on every table and buffer was full once: a day of passages, and half a day for what follows from it."""
SERIES_COUNT = 120
RESULTS_FOLDER = Path(__file__).resolve().parents[1] / "docs" / "results"
SETTINGS = {
    "ROADGRIP_DATABASE__RETENTION_S": str(24.0 * HOUR_S),
    "ROADGRIP_DATABASE__PRUNE_PERIOD_S": "5",
    "ROADGRIP_CLOCK__SPEEDUP_RATIO": str(SPEEDUP_RATIO),
    "ROADGRIP_HTTP__STREAM_HEARTBEAT_S": "0.5",
}
_MB = 1e6


@dataclass(frozen=True, slots=True)
class Sample:
    """What the unit takes at one moment.

    Attributes:
        hours: On its own clock since the start.
        rss_mb: Resident memory.
        files_count: Open file descriptors.
        db_mb: Database with its write-ahead log.
        log_mb: All it has logged so far.
        window_count: Passages in its windows.
    """

    hours: float
    rss_mb: float
    files_count: int
    db_mb: float
    log_mb: float
    window_count: int


def vehicles_per_hour(hours: float) -> float:
    """Return how many vehicles come in an hour at some time of the day: a slow wave, lowest at four."""
    wave = 0.5 - 0.5 * cos(2.0 * pi * (hours - 4.0) / DAY_HOURS)
    return NIGHT_PER_HOUR + (DAY_PER_HOUR - NIGHT_PER_HOUR) * wave


def soak(folder: Path, *, hours: float, seed: int = SEED) -> dict[str, Any]:
    """Return what a unit took over so many hours of its own clock.

    Args:
        folder: Takes configuration, database and log; on a real disk.
        hours: How long.
        seed: Of the traffic.
    """
    rng = np.random.default_rng(seed)
    with serving(folder, environment=SETTINGS) as unit, line_to(unit.host, unit.udp_port) as air:
        samples, sent_count = _driven(unit, air, hours=hours, rng=rng)
        answered = {
            verdict: int(unit.metric("roadgrip_passages_total", outcome=verdict))
            for verdict in ("counted", "uncounted", "repeated", "rejected")
        }
        dropped_count = int(unit.metric("roadgrip_frames_dropped_total"))
    settled = [sample for sample in samples if sample.hours >= min(SETTLED_HOURS, 0.5 * hours)]
    first, last = _ends(settled)
    return {
        "hours_simulated": hours,
        "rss_growth_mb": round(_median(last, "rss_mb") - _median(first, "rss_mb"), 2),
        "fd_growth": int(_median(last, "files_count") - _median(first, "files_count")),
        "db_mb_max": round(max(sample.db_mb for sample in samples), 2),
        "db_growth_mb": round(_median(last, "db_mb") - _median(first, "db_mb"), 2),
        "log_mb": round(samples[-1].log_mb, 2),
        "rss_mb_max": round(max(sample.rss_mb for sample in samples), 1),
        "files_count_max": max(sample.files_count for sample in samples),
        "frames_sent_count": sent_count,
        "passages": answered,
        "frames_dropped_count": dropped_count,
        "speedup_ratio": SPEEDUP_RATIO,
        "seed": seed,
        "growth_is": "median of the last quarter minus that of the first quarter of the settled time",
        "settled_from_hours": settled[0].hours,
        "conditions": conditions(folder),
        "series": _decimated(samples),
    }


def _driven(unit: Unit, air: Line, *, hours: float, rng: np.random.Generator) -> tuple[list[Sample], int]:
    samples: list[Sample] = []
    sent_count, due_count, spoken_at_s = 0, 0.0, {"sample": 0.0, "monitor": 0.0, "readers": 0.0}
    listeners: list[socket.socket] = []
    began_s = time.monotonic()
    at_hours = 0.0
    while at_hours < hours:
        time.sleep(STEP_S)
        elapsed_s = time.monotonic() - began_s
        earlier_hours, at_hours = at_hours, elapsed_s * SPEEDUP_RATIO / HOUR_S
        due_count += vehicles_per_hour(at_hours) * (at_hours - earlier_hours)
        frames = _traffic(int(due_count), rng=rng)
        due_count -= int(due_count)
        sent_count += _send(air, frames)
        if elapsed_s - spoken_at_s["sample"] >= SAMPLE_S:
            spoken_at_s["sample"] = elapsed_s
            samples.append(_sample(unit, at_hours))
            _tell(samples[-1], hours=hours)
        if elapsed_s - spoken_at_s["monitor"] >= MONITOR_S:
            spoken_at_s["monitor"] = elapsed_s
            unit.get("/metrics")
        if elapsed_s - spoken_at_s["readers"] >= READERS_S:
            spoken_at_s["readers"] = elapsed_s
            listeners = _readers(unit, listeners)
    for listener in listeners:
        listener.close()
    print(flush=True)
    return samples, sent_count


def _traffic(count: int, *, rng: np.random.Generator) -> list[bytes]:
    if count == 0:
        return []
    frames = draw_batch(count, rng=rng).frames()
    for number in range(count):
        if rng.random() < SPOILED_FRAC:
            spoiled = bytearray(frames[number])
            spoiled[rng.integers(len(spoiled))] ^= 1 << int(rng.integers(8))
            frames.append(bytes(spoiled))
        if rng.random() < REPEATED_FRAC:
            frames.append(frames[number])
        if rng.random() < RUBBISH_FRAC:
            frames.append(rng.bytes(int(rng.integers(1, 1_400))))
    return frames


def _send(air: Line, frames: Sequence[bytes]) -> int:
    """Send frames, each from the next source, after what came back was read."""
    for link in air.sockets:
        try:
            while link.recv(2_048):
                pass
        except BlockingIOError:
            pass
    for number, frame in enumerate(frames):
        air.sockets[number % len(air.sockets)].send(frame)
    return len(frames)


def _readers(unit: Unit, listeners: list[socket.socket]) -> list[socket.socket]:
    """Read what people read; open an event stream and a half request, and leave those of a while ago in silence."""
    for section in served_sections():
        for question in ("advisory", "map", "friction"):
            unit.get(f"/v1/sections/{section.section_id}/{question}")
    name = served_sections()[0].section_id
    stream = f"GET /v1/sections/{name}/friction/stream HTTP/1.1\r\nHost: unit\r\n\r\n"
    for start in (stream, "POST /v1/frames HTTP/1.1\r\n"):
        link = socket.create_connection((unit.host, unit.http_port), timeout=5.0)
        link.sendall(start.encode())
        listeners.append(link)
    for link in listeners[:-6]:
        link.close()
    return listeners[-6:]


def _sample(unit: Unit, hours: float) -> Sample:
    database = [unit.folder / f"rsu.sqlite3{ending}" for ending in ("", "-wal", "-shm")]
    return Sample(
        hours=hours,
        rss_mb=unit.resident_mb,
        files_count=sum(1 for _ in Path(f"/proc/{unit.process_id}/fd").iterdir()),
        db_mb=sum(path.stat().st_size for path in database if path.exists()) / _MB,
        log_mb=(unit.folder / "log").stat().st_size / _MB,
        window_count=int(unit.metric("roadgrip_window_passages")),
    )


def _tell(sample: Sample, *, hours: float) -> None:
    print(
        f"\r{sample.hours:5.0f} of {hours:.0f} h   {sample.rss_mb:6.1f} MB   {sample.files_count:3d} files   "
        f"database {sample.db_mb:6.2f} MB   log {sample.log_mb:6.2f} MB   window {sample.window_count:5d}",
        end="",
        flush=True,
    )


def _ends(settled: Sequence[Sample]) -> tuple[Sequence[Sample], Sequence[Sample]]:
    quarter = max(1, len(settled) // 4)
    return settled[:quarter], settled[-quarter:]


def _median(samples: Sequence[Sample], name: str) -> float:
    return float(np.median([getattr(sample, name) for sample in samples]))


def _decimated(samples: Sequence[Sample]) -> dict[str, list[float]]:
    step = max(1, len(samples) // SERIES_COUNT)
    return {name: [round(getattr(s, name), 3) for s in samples[::step]] for name in Sample.__slots__}


def draw(figures: dict[str, Any], folder: Path) -> str:
    """Write the picture and return its file's name."""
    series = figures["series"]
    days = np.array(series["hours"]) / DAY_HOURS
    figure, axes = panels(1, 3, title=f"{figures['hours_simulated']:g} hours beside the road")
    for panel, name, title, unit in zip(
        axes,
        ("rss_mb", "db_mb", "files_count"),
        ("Resident memory", "Database with its log", "Open files"),
        ("MB", "MB", "count"),
        strict=True,
    ):
        line(panel, days, np.array(series[name], dtype=np.float64), OURS)
        panel.axvspan(0.0, figures["settled_from_hours"] / DAY_HOURS, color="#f0f0f0", zorder=0)
        panel.set_ylim(bottom=0.0)
        headroom(panel)
        label(panel, title, x="days", y=unit)
    line(axes[1], days, np.array(series["log_mb"], dtype=np.float64), QUIET)
    legend(axes[1], ("database", OURS), ("all that was logged so far", QUIET))
    return write(figure, folder, "soak")


def main() -> None:
    """Soak, write, and say what came out."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--hours", type=float, default=7 * DAY_HOURS, help="on the unit's clock")
    parser.add_argument("--out", type=Path, help="folder for figures and picture; docs/results for the whole week")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=Path.cwd() / "build" if (Path.cwd() / "build").is_dir() else None) as folder:
        figures = soak(Path(folder), hours=chosen.hours)
    out = chosen.out or (RESULTS_FOLDER if chosen.hours >= 7 * DAY_HOURS else None)
    if out is not None:
        keep_figures(out / "soak.json", figures)
        draw(figures, out)
    print(json.dumps({key: value for key, value in figures.items() if key not in {"series", "conditions"}}, indent=1))


if __name__ == "__main__":
    main()
