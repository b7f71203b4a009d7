"""A client that loses its power again and again, in bad air: nothing is doubled, lost, or sent beyond the budget."""

import json
import select
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from roadgrip.frames import parse_frame
from roadgrip.records import VEHICLE_FRAME_BUDGET
from roadgrip.section_file import section_to_json
from tests.system.daemons import Daemon
from tests.vehicle_client.shell.live.cars import ROAD, SPEEDUP, Car, a_drive, free_udp_port, standing, unit_settings

pytestmark = [pytest.mark.system, pytest.mark.long, pytest.mark.timeout(900)]

KILLS_COUNT = 20
LOST_UP_FRAC, LOST_DOWN_FRAC = 0.3, 0.75


@contextmanager
def bad_air(unit_port: int, sent: Counter[bytes]) -> Iterator[int]:
    """Yield a port that carries some frames to the unit and fewer back, and count what each exchange sends."""
    rng, over = np.random.default_rng(7), threading.Event()
    unit = ("127.0.0.1", unit_port)
    ways: dict[tuple[str, int], socket.socket] = {}

    def carry(air: socket.socket) -> None:
        while not over.is_set():
            for link in select.select([air, *ways.values()], [], [], 0.05)[0]:
                data, source = link.recvfrom(2_048)
                if link is air:
                    sent[parse_frame(data).exchange_id] += 1
                    if source not in ways:
                        ways[source] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                        ways[source].bind(("127.0.0.1", 0))
                    if rng.random() >= LOST_UP_FRAC:
                        ways[source].sendto(data, unit)
                elif rng.random() >= LOST_DOWN_FRAC:
                    air.sendto(data, next(car for car, way in ways.items() if way is link))

    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as air:
        air.bind(("127.0.0.1", 0))
        thread = threading.Thread(target=carry, args=(air,))
        thread.start()
        try:
            yield air.getsockname()[1]
        finally:
            over.set()
            thread.join()
            for way in ways.values():
                way.close()


def json_id(path: Path) -> str:
    return str(json.loads(path.read_text(encoding="utf-8"))["passage_id"])


def test_twenty_power_cuts_double_nothing_lose_nothing_and_keep_the_budget(tmp_path: Path):
    rng, sent, spooled = np.random.default_rng(1), Counter[bytes](), set[str]()
    folder, beacon_port = tmp_path / "unit", free_udp_port()
    folder.mkdir()
    (tmp_path / "known.json").write_text(section_to_json(ROAD), encoding="utf-8")
    with Daemon(folder, unit_settings(folder, beacon_port=beacon_port)) as unit:
        with bad_air(unit.udp_port, sent) as air_port:
            options = ("--beacons", "none", "--rsu", f"udp://127.0.0.1:{air_port}")
            for seed in range(KILLS_COUNT):
                trace = a_drive(seed=100 + seed)
                with Car(tmp_path / "car", trace, *options, "--section", str(tmp_path / "known.json")) as car:
                    car.wait_for(partial(car.events, "started"))
                    time.sleep(float(trace.time_s[-1]) / SPEEDUP + rng.uniform(-1.5, 3.5))
                    car.kill()
                assert car.events("started")[0]["spool_dropped_unreadable"] == 0
                spooled |= {json_id(path) for path in car.spooled()}
        with Car(tmp_path / "car", standing(a_drive()), "--beacons", f"127.0.0.1:{beacon_port}") as last:
            last.wait_for(lambda: not last.spooled())
            assert last.stop() == 0
        stored = [passage.passage_id.hex() for passage in unit.stored()]
    assert len(stored) == len(set(stored))
    assert spooled <= set(stored)
    assert max(sent.values()) <= VEHICLE_FRAME_BUDGET
