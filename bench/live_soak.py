"""Two hours at the wheel in some minutes: what the live client takes, and whether it takes more and more.

python -m bench.live_soak                  two hours, five minutes on the wall (`make live-soak`)
python -m bench.live_soak --hours 0.2      shorter; nothing is written without --out

A client in a process of its own drives simulated passages of three sections one after another, two of three with
positions, over plain road in between. A road side unit runs beside it, behind air that loses, doubles, delays and
spoils frames; for a quarter of the journey no unit is there at all, longer than the spool can hold. A dashboard asks
for the counters once a second, and others come and go. Roads, drives and timetable come from fixed seeds; what the air
does to which frame depends on the machine's timing.

Writes docs/results/onboard/live_soak.json and live_soak.svg.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import re
import signal
import socket
import sys
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.live.air import Air
from bench.live.journey import Journey, Leg, write_journey
from bench.measurement import ROADS, keep_figures
from bench.validation.picture import OURS, QUIET, THEORY, headroom, label, legend, line, panels, write
from roadgrip.sections import read_section
from vehicle_client.shell.sources import write_trace_csv
from vehicle_client.shell.uplink import AirFaults
from vehicle_client.simulator.run import draw_plan, each_passage

SEED = 20261122
SPEEDUP = 24.0
SPOOL_CAPACITY_COUNT = 8
GAP_S = (60.0, 120.0)
AWAY_FROM_FRAC, AWAY_UNTIL_FRAC = 0.4, 0.65
"""Part of the journey without any unit."""
HEARD_BESIDE_S = 20.0
"""A unit is heard so long before and after a drive."""
AIR = AirFaults(lost_frac=0.15, doubled_frac=0.05, delayed_frac=0.05, spoiled_frac=0.05, delay_s=0.3)
SAMPLE_S = 1.0
SERIES_COUNT = 40
"""Samples that are kept in the figures."""
SETTLED_FRAC = 0.25
"""After this part of the journey everything has been taken once."""
RESULTS_FOLDER = Path(__file__).resolve().parents[1] / "docs" / "results" / "onboard"
_MB = 1e6
_HOUR_S = 3600.0


@dataclass(frozen=True, slots=True)
class Sample:
    """What was seen of the client at one time.

    Attributes:
        driven_s: On the journey's clock.
        rss_mb: Memory of the process.
        files_count: Open file descriptors.
        threads_count: Threads.
        spool_count: Summaries that wait.
        spool_kb: All files of the spool's folder, maps included.
        ring_mb: Memory of the recording.
        passes_count: Passes that are open.
    """

    driven_s: float
    rss_mb: float
    files_count: int
    threads_count: int
    spool_count: int
    spool_kb: float
    ring_mb: float
    passes_count: int


def plan_journey(folder: Path, *, duration_s: float) -> Journey:
    """Return a timetable, and write the drives that it names into a folder."""
    (folder / "unit").mkdir()
    rng = np.random.default_rng(SEED)
    sections = {name: read_section(name) for name in ROADS}
    wanted_count = int(duration_s / 90.0) + 3
    drives = {}
    for name, section in sections.items():
        plans = (
            replace(draw_plan(rng, section=section, base_friction_mu=float(rng.uniform(0.5, 0.9))), with_gnss=k % 3 > 0)
            for k in range(wanted_count)
        )
        drives[name] = [drive for drive in each_passage(section, plans) if drive.completed]
    legs: list[Leg] = []
    now_s = 30.0
    while True:
        name = ROADS[int(rng.integers(len(ROADS)))]
        drive = drives[name].pop(0)
        ends_s = now_s + float(np.ptp(drive.trace.time_s))
        if ends_s + GAP_S[0] > duration_s:
            return Journey(tuple(legs), duration_s)
        file = f"{len(legs):03d}.csv"
        write_trace_csv(folder / file, drive.trace)
        legs.append(Leg(file, name, now_s, ends_s, drive.trace.gnss is not None))
        now_s = ends_s + float(rng.uniform(*GAP_S))


class Scene:
    """What the air must know: what time it is on the journey, and so where the car is."""

    def __init__(self, journey: Journey, *, speedup_ratio: float) -> None:
        """Stand still."""
        self._journey = journey
        self._speedup_ratio = speedup_ratio
        self._begun_s: float | None = None

    def begin(self) -> None:
        """Set off."""
        self._begun_s = time.monotonic()

    @property
    def driven_s(self) -> float:
        """The journey's clock."""
        return 0.0 if self._begun_s is None else (time.monotonic() - self._begun_s) * self._speedup_ratio

    def in_reach(self, section_id: str) -> bool:
        """Return whether a unit of the section (of any, if empty) is in reach."""
        driven_s, duration_s = self.driven_s, self._journey.duration_s
        if AWAY_FROM_FRAC <= driven_s / duration_s < AWAY_UNTIL_FRAC:
            return False
        return section_id == "" or any(
            leg.section_id == section_id and leg.begins_s - HEARD_BESIDE_S <= driven_s <= leg.ends_s + HEARD_BESIDE_S
            for leg in self._journey.legs
        )


async def soak(folder: Path, *, duration_s: float, speedup_ratio: float = SPEEDUP) -> dict[str, Any]:
    """Return the figures of one journey.

    Args:
        folder: Empty; takes recordings, spool, logs and the unit's database.
        duration_s: Of the journey, on its own clock.
        speedup_ratio: How fast it is driven.
    """
    journey = await asyncio.to_thread(plan_journey, folder, duration_s=duration_s)
    write_journey(folder / "journey.json", journey)
    scene = Scene(journey, speedup_ratio=speedup_ratio)
    beacon_port = _free_udp_port()
    air = Air(
        AIR,
        unit=("127.0.0.1", 0),
        beacons_to=("127.0.0.1", beacon_port),
        in_reach=scene.in_reach,
        rng=np.random.default_rng(SEED),
    )
    try:
        async with unit_serving(folder / "unit", beacons_to_port=await air.open()) as unit_port:
            air.at_unit(("127.0.0.1", unit_port))
            with (folder / "car.log").open("wb") as log:
                car = await asyncio.create_subprocess_exec(
                    *(sys.executable, "-m", "bench.live.car", str(folder / "journey.json"), "--folder", str(folder)),
                    *("--speedup", str(speedup_ratio), "--beacon-port", str(beacon_port)),
                    *("--spool-capacity", str(SPOOL_CAPACITY_COUNT)),
                    stdout=log,
                )
                try:
                    samples, busy_s = await _watched(car, folder, scene)
                finally:
                    if car.returncode is None:
                        car.kill()
                    await car.wait()
    finally:
        air.close()
    figures = {"seed": SEED, "speedup": speedup_ratio, "exit_code": car.returncode}
    figures |= _told(journey, air, _lines(folder / "car.log")) | _taken(journey, samples)
    busy = {"processor_s_per_hour_driven": round(busy_s / (samples[-1].driven_s / _HOUR_S), 2)}
    return figures | busy | {"series": _decimated(samples)}


@contextlib.asynccontextmanager
async def unit_serving(folder: Path, *, beacons_to_port: int) -> AsyncIterator[int]:
    """Yield the UDP port of a road side unit that serves all sections."""
    settings = '[database]\npath = "rsu.sqlite3"\n[http]\nport = 0\n[udp]\nport = 0\nbroadcast_host = "127.0.0.1"\n'
    settings += f"broadcast_port = {beacons_to_port}\nbeacon_period_s = 0.2\n"
    settings += "".join(f'[[sections]]\nfile = "{name}"\n' for name in ROADS)
    (folder / "rsu.toml").write_text(settings, encoding="utf-8")
    with (folder / "log").open("wb") as log:
        unit = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "rsu_app", "serve", "--config", str(folder / "rsu.toml")), stdout=log, stderr=log
        )
        try:
            serving = await _event(folder / "log", "serving")
            yield int(re.sub(r".*:", "", serving["udp"]))
        finally:
            if unit.returncode is None:
                unit.send_signal(signal.SIGTERM)
            await unit.wait()


async def _watched(car: asyncio.subprocess.Process, folder: Path, scene: Scene) -> tuple[list[Sample], float]:
    """Look at the car until it ends; return what was seen, and the processor's time that it took."""
    await _event(folder / "car.log", "started")
    scene.begin()
    reader, writer = await asyncio.open_unix_connection(folder / "dash.sock", limit=1_000_000)
    samples: list[Sample] = []
    busy_s = 0.0
    ended = asyncio.ensure_future(car.wait())
    try:
        while not ended.done():
            # Another dashboard comes and goes, without a word or having asked.
            with contextlib.suppress(OSError):
                _, guest = await asyncio.open_unix_connection(folder / "dash.sock")
                guest.write(b"counters\n" if len(samples) % 2 else b"")
                guest.close()
            try:
                writer.write(b"counters\n")
                counters = await asyncio.wait_for(_counters(reader), 5.0)
                samples.append(_sample(car.pid, folder / "spool", counters, scene.driven_s))
                busy_s = _busy_s(car.pid)
            except (OSError, EOFError):
                pass  # it is ending
            await asyncio.wait({ended}, timeout=SAMPLE_S)
    finally:
        writer.close()
        ended.cancel()
    return samples, busy_s


async def _counters(reader: asyncio.StreamReader) -> dict[str, Any]:
    while line_read := await reader.readline():
        told = json.loads(line_read)
        if told["type"] == "counters":
            counters: dict[str, Any] = told["counters"]
            return counters
    raise EOFError


def _sample(pid: int, spool: Path, counters: dict[str, Any], driven_s: float) -> Sample:
    process = Path("/proc") / str(pid)
    size_bytes = 0
    for path in spool.rglob("*.json"):
        with contextlib.suppress(FileNotFoundError):
            size_bytes += path.stat().st_size
    return Sample(
        driven_s=round(driven_s, 1),
        rss_mb=round(int((process / "statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / _MB, 2),
        files_count=len(list((process / "fd").iterdir())),
        threads_count=len(list((process / "task").iterdir())),
        spool_count=int(counters["spool_waiting"]),
        spool_kb=round(size_bytes / 1e3, 1),
        ring_mb=round(counters["ring_bytes"] / _MB, 2),
        passes_count=int(counters["passages_open"]),
    )


def _busy_s(pid: int) -> float:
    fields = (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _told(journey: Journey, air: Air, log: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return what the client's log and the air say of the passages."""
    passages = [entry for entry in log if entry["event"] == "passage"]
    stopped = next((entry for entry in log if entry["event"] == "stopped"), {})
    return {
        "hours": journey.duration_s / _HOUR_S,
        "drives_count": len(journey.legs),
        "drives_with_fixes_count": sum(leg.with_fixes for leg in journey.legs),
        "endings": dict(sorted(Counter(("late_" if p["late"] else "") + p["ending"] for p in passages).items())),
        "dropped_for_want_of_room_count": int(stopped.get("spool_dropped_overflow", 0)),
        "waiting_at_the_end_count": int(stopped.get("spool_waiting", 0)),
        "failures_count": sum(entry["event"] == "failure" for entry in log),
        "most_frames_of_a_passage_count": max(air.sent.values(), default=0),
        "air": asdict(air.counts),
        "counters": {k: v for k, v in stopped.items() if k != "event"},
    }


def _taken(journey: Journey, samples: Sequence[Sample]) -> dict[str, Any]:
    """Return what the client took of the machine, and whether that grew."""
    settled = [s for s in samples if s.driven_s >= SETTLED_FRAC * journey.duration_s]
    quarter_of = [min(3, int(4.0 * s.driven_s / journey.duration_s)) for s in samples]
    quarters_mb = [
        float(np.median([s.rss_mb for s, of in zip(samples, quarter_of, strict=True) if of == quarter]))
        for quarter in range(4)
    ]
    return {
        "rss_mb": {
            "end": settled[-1].rss_mb,
            "most": max(s.rss_mb for s in samples),
            "median_of_each_quarter": quarters_mb,
        },
        "files_count": {
            "settled": int(np.median([s.files_count for s in settled])),
            "end": settled[-1].files_count,
            "most": max(s.files_count for s in samples),
        },
        "threads_most_count": max(s.threads_count for s in samples),
        "spool_most_count": max(s.spool_count for s in samples),
        "spool_most_kb": max(s.spool_kb for s in samples),
        "ring_most_mb": max(s.ring_mb for s in samples),
        "passes_most_count": max(s.passes_count for s in samples),
    }


def _decimated(samples: Sequence[Sample]) -> dict[str, list[float]]:
    step = max(1, len(samples) // SERIES_COUNT)
    return {name: [getattr(s, name) for s in samples[::step]] for name in Sample.__slots__}


def draw(figures: dict[str, Any], folder: Path) -> str:
    """Write the picture and return its file's name."""
    series = figures["series"]
    hours = np.array(series["driven_s"]) / _HOUR_S
    figure, axes = panels(
        1, 2, title=f"{figures['hours']:g} hours of driving, {figures['drives_count']} drives over a section"
    )
    for values, colour in (("rss_mb", OURS), ("ring_mb", THEORY)):
        line(axes[0], hours, series[values], colour)
    for values, colour in (("files_count", QUIET), ("spool_count", OURS)):
        line(axes[1], hours, series[values], colour)
    away = [figures["hours"] * frac for frac in (AWAY_FROM_FRAC, AWAY_UNTIL_FRAC)]
    for panel in axes:
        panel.set_ylim(bottom=0.0)
        panel.axvspan(*away, color="#f0f0f0", zorder=0)
        headroom(panel)
    label(axes[0], "Memory", x="hours driven", y="MB")
    label(axes[1], "Files and summaries", x="hours driven", y="count")
    legend(axes[0], ("resident memory of the process", OURS), ("recording (ring)", THEORY))
    legend(axes[1], ("open files", QUIET), ("summaries that wait; grey: no unit anywhere", OURS))
    return write(figure, folder, "live_soak")


async def _event(path: Path, name: str) -> dict[str, Any]:
    for _ in range(1_200):
        for entry in _lines(path):
            if entry.get("event") == name:
                return entry
        await asyncio.sleep(0.05)
    raise TimeoutError(f"no {name} in {path}")


def _lines(path: Path) -> list[dict[str, Any]]:
    text = path.read_text(encoding="utf-8")
    return [json.loads(each) for each in text.splitlines(keepends=True) if each.endswith("\n")]


def _free_udp_port() -> int:
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as link:
        link.bind(("127.0.0.1", 0))
        return int(link.getsockname()[1])


def main() -> None:
    """Soak, write, and say what came out."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--speedup", type=float, default=SPEEDUP)
    parser.add_argument(
        "--out", type=Path, help="folder for figures and picture; docs/results/onboard for the two hours"
    )
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        figures = asyncio.run(soak(Path(folder), duration_s=chosen.hours * _HOUR_S, speedup_ratio=chosen.speedup))
    out = chosen.out or (RESULTS_FOLDER if chosen.hours >= 2.0 else None)
    if out is not None:
        keep_figures(out / "live_soak.json", figures)
        draw(figures, out)
    print(json.dumps({k: v for k, v in figures.items() if k != "series"}, indent=1))


if __name__ == "__main__":
    main()
