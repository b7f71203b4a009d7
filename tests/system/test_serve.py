"""The road side unit as a process: what survives a kill, how it stops, what it says over real sockets."""

import json
import random
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import httpx
import pytest

from roadgrip.records import Accepted, Arrival, Cookie, MapOffer, Receipt
from roadgrip.section import RoadSection
from roadgrip.section_file import section_from_json
from tests.rsu_app.fakes import make_passage
from tests.rsu_app.sites import frame_of_passage, frames_of, passage_json, read_frames
from tests.system.daemons import Daemon

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

PASSAGES = "/v1/sections/long-turn/passages"


def section_of(daemon: Daemon) -> RoadSection:
    return section_from_json(daemon.client.get("/v1/sections/long-turn/map").text)


def stored_ids(folder: Path) -> set[str]:
    with closing(sqlite3.connect(folder / "rsu.sqlite3")) as database:
        return {row[0].hex() for row in database.execute("SELECT passage_id FROM passages")}


def window_count(daemon: Daemon) -> int:
    interval = daemon.client.get("/v1/sections/long-turn/friction").json()["interval"]
    return 0 if interval is None else int(interval["passages_count"])


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 12))])
def test_a_kill_in_the_middle_of_ingest_loses_no_acknowledged_passage(tmp_path, seed):
    acknowledged: list[str] = []
    dead = threading.Event()
    with Daemon(tmp_path) as daemon:
        section = section_of(daemon)
        bodies = [passage_json(make_passage(section, seed=1000 * seed + n, mu=0.4)) for n in range(600)]

        def post(part: list[dict[str, object]]) -> None:
            with httpx.Client(base_url=daemon.url, timeout=10.0) as client:
                for body in part:
                    try:
                        answer = client.post(PASSAGES, json=body)
                    except httpx.TransportError:
                        if dead.is_set():
                            return
                        raise
                    if answer.status_code == 200:
                        acknowledged.append(answer.json()["passage_id"])

        with ThreadPoolExecutor(4) as pool:
            work = [pool.submit(post, bodies[n::4]) for n in range(4)]
            give_up_s = time.monotonic() + 60.0
            while len(acknowledged) < 20 + 40 * random.Random(seed).random() and time.monotonic() < give_up_s:
                time.sleep(0.001)
            dead.set()
            daemon.kill()
            for done in work:
                done.result()
    assert 20 <= len(acknowledged) < len(bodies), "the kill must come in the middle"

    kept = stored_ids(tmp_path)
    assert set(acknowledged) <= kept
    with Daemon(tmp_path) as daemon:
        assert daemon.restored_count == len(kept)
        assert window_count(daemon) == len(kept)
        # A vehicle whose receipt was lost sends again: answered, and counted once.
        by_id = {str(body["passage_id"]): body for body in bodies}
        for passage_id in sorted(kept)[:10]:
            receipt = daemon.client.post(PASSAGES, json=by_id[passage_id] | {"age_s": 30.0})
            assert receipt.json()["counted"] is True
        assert window_count(daemon) == len(kept)


def test_the_exchange_over_a_real_socket_and_over_cellular(tmp_path):
    with Daemon(tmp_path) as daemon, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
        radio.settimeout(20.0)
        radio.connect(("127.0.0.1", daemon.udp_port))
        section = section_of(daemon)
        passage = make_passage(section, seed=1)
        arrival = Arrival(passage.passage_id, section.section_id)
        (asked,) = frames_of(arrival, passage_id=passage.passage_id, section_id=section.section_id)
        radio.send(asked)
        (cookie,) = read_frames([radio.recv(2000)])
        assert isinstance(cookie, Cookie)
        shown = replace(arrival, cookie=cookie.cookie)
        (asked_again,) = frames_of(shown, passage_id=passage.passage_id, section_id=section.section_id)
        radio.send(asked_again)
        heard = [radio.recv(2000), radio.recv(2000)]
        assert MapOffer in {type(message) for message in read_frames(heard)}
        radio.send(b"rubbish")
        radio.send(frame_of_passage(passage))
        assert read_frames([radio.recv(2000)]) == [Receipt(passage.passage_id, Accepted())]

        again = daemon.client.post(
            "/v1/frames",
            content=frame_of_passage(passage),
            headers={"content-type": "application/vnd.roadgrip.frames"},
        )
        assert read_frames([again.content]) == [Receipt(passage.passage_id, Accepted())]
        assert window_count(daemon) == 1
        assert daemon.client.get("/health/ready").status_code == 200
        lines = [line for line in daemon.lines() if line["event"] == "passage"]
        assert [(line["outcome"], line["via"]) for line in lines] == [("counted", "udp"), ("repeated", "http")]


def test_a_unit_that_is_asked_to_stop_ends_its_streams_and_itself(tmp_path):
    with Daemon(tmp_path) as daemon:
        with daemon.client.stream("GET", "/v1/sections/long-turn/friction/stream") as stream:
            pieces = stream.iter_lines()
            data = next(line for line in pieces if line.startswith("data: "))
            assert json.loads(data.removeprefix("data: "))["section_id"] == "long-turn"
            started_s = time.monotonic()
            assert daemon.stop() == 0
            assert time.monotonic() - started_s < 20.0
            list(pieces)
        assert daemon.lines()[-1]["event"] == "stopped"
        assert {line["level"] for line in daemon.lines()} == {"info"}


def test_a_detection_is_broadcast_and_beacons_fly(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
        radio.bind(("127.0.0.1", 0))
        radio.settimeout(20.0)
        target = f'broadcast_host = "127.0.0.1"\nbroadcast_port = {radio.getsockname()[1]}\nbeacon_period_s = 0.05\n'
        with Daemon(tmp_path, target) as daemon:
            answer = daemon.client.post("/v1/sections/long-turn/detections", json={"source": "loop-1"})
            assert answer.json()["frames_sent_count"] >= 2
            heard: set[str] = set()
            while heard != {"MapOffer", "AdvisoryNotice", "Beacon"}:
                heard |= {type(message).__name__ for message in read_frames([radio.recv(2000)])}


def test_a_unit_without_its_bundle_serves_the_winter_speed_and_is_not_ready(tmp_path):
    (tmp_path / "bundle").mkdir()
    with Daemon(tmp_path, "[clock]\nspeedup_ratio = 60.0\n") as daemon:
        (warning,) = [line for line in daemon.lines() if line["event"] == "clock_accelerated"]
        assert warning["level"] == "warning", "a clock for demonstrations is said loudly"
        readiness = daemon.client.get("/health/ready")
        assert (readiness.status_code, readiness.json()["ready"]) == (503, False)
        assert daemon.client.get("/v1/sections/long-turn/advisory").json()["reason"] == "winter_speed_no_model"
        assert any(line["event"] == "bundle_unusable" for line in daemon.lines())


def test_a_taken_port_is_one_line_and_exit_code_2(tmp_path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        config = tmp_path / "rsu.toml"
        config.write_text(f"[http]\nport = {other.getsockname()[1]}\n", encoding="utf-8")
        done = subprocess.run(
            [sys.executable, "-m", "rsu_app", "serve", "--config", str(config)],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr.startswith("roadgrip-rsu: cannot listen on http")
    assert done.stderr.count("\n") == 1
