"""The live client and a road side unit as real processes: what a driver sees, and what survives."""

import asyncio
import json
import secrets
import signal
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from roadgrip.section_file import section_to_json
from tests.system.daemons import Daemon
from tests.vehicle_client.shell.live.cars import ROAD, SPEEDUP, Car, a_drive, free_udp_port, standing, unit_settings
from vehicle_client.shell.can.buses import open_bus
from vehicle_client.shell.can.description import EXAMPLE, path_of_signals, read_can_mapping
from vehicle_client.shell.can.live import CanSource
from vehicle_client.shell.can.written import frames_of_trace, message_of
from vehicle_client.shell.live.client import LiveClient
from vehicle_client.shell.live.settings import LiveSettings
from vehicle_client.shell.live.source import LiveBus
from vehicle_client.shell.spool import boot_clock
from vehicle_client.shell.uplink import UnitAddress

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]


@dataclass(frozen=True)
class Roadside:
    """One unit for all tests, and where it sends its beacons; every drive is another one, or it would be a replay."""

    unit: Daemon
    beacon_port: int

    @property
    def beacons(self) -> tuple[str, str]:
        return "--beacons", f"127.0.0.1:{self.beacon_port}"


@pytest.fixture(scope="module")
def roadside(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Roadside]:
    folder, port = tmp_path_factory.mktemp("unit"), free_udp_port()
    with Daemon(folder, unit_settings(folder, beacon_port=port)) as unit:
        yield Roadside(unit, port)


def advised(line: dict[str, Any]) -> bool:
    return line["type"] == "state" and bool(line["advice"])


def withdrawn(line: dict[str, Any]) -> bool:
    return line["type"] == "state" and not line["advice"] and not line["sections"]


@pytest.mark.parametrize("satellites", [True, False], ids=["with satellites", "without"])
def test_a_driver_is_advised_and_the_passage_is_accepted(tmp_path: Path, roadside: Roadside, satellites: bool):
    before_count = len(roadside.unit.stored())
    trace = a_drive(satellites=satellites, seed=10 + satellites)
    with Car(tmp_path / "car", trace, *roadside.beacons) as car:
        reader = car.dashboard()
        told = reader.until(advised)
        (advice,) = told["advice"]
        assert advice["section_id"] == ROAD.section_id
        assert 0.0 < advice["valid_for_s"] <= 300.0
        assert told["sections"][0]["map_version"] == ROAD.version
        reader.until(withdrawn)
        reader.ask("counters")
        car.wait_for(lambda: car.events("passage"))
        car.process.send_signal(signal.SIGUSR1)
        car.wait_for(lambda: car.events("counters"))
        assert reader.until(lambda line: line["type"] == "counters")["counters"]["pipeline_runs"] >= 1
        assert car.stop() == 0
        reader.close()
    (stored,) = roadside.unit.stored()[before_count:]
    (passage,) = car.events("passage")
    assert passage["ending"] == "accepted"
    assert passage["via"] == "udp"
    assert passage["method"] == ("gnss" if satellites else "dead_reckoning")
    assert stored.passage_id.hex() not in car.log.read_text(encoding="utf-8")
    assert stored.map_version == ROAD.version
    assert not car.spooled()
    assert not car.socket.exists()


def test_over_cellular_the_section_is_found_by_its_place(tmp_path: Path, roadside: Roadside):
    before_count = len(roadside.unit.stored())
    options = ("--beacons", "none", "--rsu", roadside.unit.url, "--once")
    with Car(tmp_path / "car", a_drive(seed=2), *options) as car:
        car.wait_for(lambda: car.process.poll() == 0)
    assert len(roadside.unit.stored()) == before_count + 1
    (passage,) = car.events("passage")
    assert (passage["ending"], passage["via"]) == ("accepted", "http")


def spool_one(folder: Path, tmp_path: Path, *, seed: int) -> Car:
    """Drive where no unit is; the summary waits."""
    (tmp_path / "known.json").write_text(section_to_json(ROAD), encoding="utf-8")
    options = ("--beacons", "none", "--once", "--section", str(tmp_path / "known.json"))
    with Car(folder, a_drive(seed=seed), *options) as car:
        car.wait_for(lambda: car.process.poll() == 0)
    assert len(car.spooled()) == 1
    return car


def test_what_had_to_wait_is_delivered_at_the_next_unit_with_its_right_age(tmp_path: Path, roadside: Roadside):
    car = spool_one(tmp_path / "car", tmp_path, seed=3)
    left_at_s = json.loads(car.spooled()[0].read_text(encoding="utf-8"))["left_at_s"]
    before_count = len(roadside.unit.stored())
    least_s = boot_clock()[1] - left_at_s
    with Car(tmp_path / "car", standing(a_drive()), *roadside.beacons) as later:
        later.wait_for(lambda: any(line["late"] for line in later.events("passage")))
        assert later.stop() == 0
    most_s = boot_clock()[1] - left_at_s
    (stored,) = roadside.unit.stored()[before_count:]
    assert least_s - 0.01 <= stored.age_s <= most_s + 0.01
    (late,) = [line for line in later.events("passage") if line["late"]]
    assert late["ending"] == "accepted"
    assert not later.spooled()


def test_after_a_reboot_nobody_knows_the_age_so_it_is_dropped_and_counted(tmp_path: Path, roadside: Roadside):
    (path,) = spool_one(tmp_path / "car", tmp_path, seed=4).spooled()
    entry = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(entry | {"clock_id": "the boot before"}), encoding="utf-8")
    before_count = len(roadside.unit.stored())
    with Car(tmp_path / "car", standing(a_drive()), *roadside.beacons) as car:
        car.wait_for(lambda: car.events("started"))
        assert car.stop() == 0
    assert len(roadside.unit.stored()) == before_count
    assert car.events("started")[0]["spool_dropped_age_unknown"] == 1
    assert car.events("stopped")[0]["spool_waiting"] == 0


@contextmanager
def deaf_air(unit_port: int):
    """Yield a port that carries frames to the unit, and nothing back."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as link:
        link.bind(("127.0.0.1", 0))
        link.settimeout(0.1)
        over = threading.Event()

        def carry() -> None:
            while not over.is_set():
                try:
                    data, _ = link.recvfrom(2_048)
                except TimeoutError:
                    continue
                link.sendto(data, ("127.0.0.1", unit_port))

        thread = threading.Thread(target=carry)
        thread.start()
        yield link.getsockname()[1]
        over.set()
        thread.join()


def test_a_client_killed_before_its_receipt_delivers_once(tmp_path: Path, roadside: Roadside):
    (tmp_path / "known.json").write_text(section_to_json(ROAD), encoding="utf-8")
    unit = roadside.unit
    before_count = len(unit.stored())
    with deaf_air(unit.udp_port) as air_port:
        options = ("--beacons", "none", "--rsu", f"udp://127.0.0.1:{air_port}")
        with Car(tmp_path / "car", a_drive(seed=5), *options, "--section", str(tmp_path / "known.json")) as car:
            car.wait_for(lambda: len(unit.stored()) > before_count)
            car.kill()
    assert len(car.spooled()) == 1
    with Car(tmp_path / "car", standing(a_drive()), *roadside.beacons) as again:
        again.wait_for(lambda: any(line["late"] for line in again.events("passage")))
        assert again.stop() == 0
    assert len(unit.stored()) == before_count + 1
    (late,) = [line for line in again.events("passage") if line["late"]]
    assert late["ending"] == "accepted"
    assert not again.spooled()


def test_a_client_that_is_stopped_while_it_sends_keeps_the_summary_and_its_frames(tmp_path: Path):
    (tmp_path / "known.json").write_text(section_to_json(ROAD), encoding="utf-8")
    options = ("--beacons", "none", "--rsu", f"udp://127.0.0.1:{free_udp_port()}")
    with Car(tmp_path / "car", a_drive(), *options, "--section", str(tmp_path / "known.json")) as car:
        car.wait_for(car.spooled)
        assert car.stop() == 0
    (path,) = car.spooled()
    assert json.loads(path.read_text(encoding="utf-8"))["frames_spent_count"] >= 2


def test_a_car_that_nobody_advises_says_what_is_wrong_with_its_settings(tmp_path: Path):
    with Car(tmp_path / "car", a_drive(), "--rsu", "ftp://unit") as car:
        assert car.process.wait(timeout=60) == 2
    assert "ftp://unit" in car.log.read_text(encoding="utf-8")


def test_a_drive_over_the_cars_own_bus_is_accepted(tmp_path: Path, roadside: Roadside):
    """The bus is python-can's virtual one, so the client lives in this process; the unit does not."""
    trace = a_drive(approach_m=150.0, exit_m=150.0, seed=6)
    before_count = len(roadside.unit.stored())
    mapping = read_can_mapping(path_of_signals(EXAMPLE))
    name = f"car-{secrets.token_hex(4)}"
    lines: list[dict[str, Any]] = []
    hand_s = [0.0]

    def drive_on(bus: Any, source: CanSource) -> None:
        """Send the frames ten times as fast as they were; the clock waits until each sample was read."""
        frames = frames_of_trace(trace, mapping)
        begun_s = time.monotonic()
        for index, at_s in enumerate(frames.time_s.tolist()):
            if at_s > hand_s[0]:
                while source.counts.frames_count < index:
                    time.sleep(0.0)
                hand_s[0] = at_s
                time.sleep(max(0.0, begun_s + at_s / 10.0 - time.monotonic()))
            bus.send(message_of(frames, index, time_s=at_s))

    async def story(unit: Daemon) -> None:
        with (
            open_bus("virtual", name) as sender,
            open_bus("virtual", name, frame_ids=mapping.frame_ids) as bus,
            CanSource(bus, mapping, now_s=lambda: hand_s[0]) as source,
        ):
            settings = LiveSettings(
                spool_folder=tmp_path / "spool", unit=UnitAddress("udp", "127.0.0.1", unit.udp_port), sections=(ROAD,)
            )
            live_bus = LiveBus(source, now_s=lambda: hand_s[0])
            client = LiveClient(settings, live_bus, write=lambda line: lines.append(json.loads(line)))
            running = asyncio.create_task(client.run())
            await asyncio.to_thread(drive_on, sender, source)
            for _ in range(600):
                if len(unit.stored()) > before_count:
                    break
                await asyncio.sleep(0.05)
            await asyncio.sleep(0.2)
            client.stop()
            await running

    asyncio.run(story(roadside.unit))
    assert len(roadside.unit.stored()) == before_count + 1
    (passage,) = [line for line in lines if line["event"] == "passage"]
    assert passage["ending"] == "accepted"
    assert lines[-1]["can_frames"] > 3_000
    assert lines[-1]["can_values_dropped"] == 0


@pytest.mark.long
def test_a_client_that_is_stopped_for_a_while_gives_one_summary_of_the_right_age(tmp_path: Path, roadside: Roadside):
    (tmp_path / "known.json").write_text(section_to_json(ROAD), encoding="utf-8")
    trace, stop_s = a_drive(seed=7), 20.0
    # From 400 m of approach and 15 m/s on: it is stopped inside the section, which it leaves while it is stopped.
    inside_s, left_s = (400.0 + 100.0) / 15.0 / SPEEDUP, (400.0 + 400.0) / 15.0 / SPEEDUP
    before_count = len(roadside.unit.stored())
    spawned_s = time.monotonic()
    with Car(tmp_path / "car", trace, *roadside.beacons, "--section", str(tmp_path / "known.json")) as car:
        car.wait_for(lambda: car.events("started"))
        started_s = time.monotonic()
        time.sleep(inside_s)
        car.process.send_signal(signal.SIGSTOP)
        time.sleep(stop_s)
        car.process.send_signal(signal.SIGCONT)
        resumed_s = time.monotonic()
        car.wait_for(lambda: car.events("passage"))
        received_s = time.monotonic()
        # Whatever else it had to say, it would have said by the end of the recording.
        car.wait_for(lambda: car.events("source_ended"))
        assert car.stop() == 0
    (stored,) = roadside.unit.stored()[before_count:]
    (passage,) = car.events("passage")
    assert passage["ending"] == "accepted"
    assert resumed_s - started_s - left_s - 1.0 <= stored.age_s <= received_s - spawned_s - left_s + 0.1
