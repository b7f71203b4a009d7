import asyncio
import contextlib
import json
import socket
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from roadgrip.errors import ConfigurationError
from tests.vehicle_client.shell.air import ADVICE, BEND
from vehicle_client.mapmatch.approach import Moment, Pass, Whereabouts
from vehicle_client.shell.live.cockpit import Cockpit
from vehicle_client.shell.live.dashboard import (
    READERS_LIMIT_COUNT,
    Dashboard,
    ShownAdvice,
    parse_dashboard_address,
)
from vehicle_client.shell.live.source import SourceState

pytestmark = pytest.mark.system


class HandClock:
    """Shows what it was set to."""

    def __init__(self) -> None:
        self.time_s = 1_000.0

    def now_s(self) -> float:
        return self.time_s

    def wall_s(self, duration_s: float) -> float:
        return duration_s


def a_cockpit(clock: HandClock, counts: Counter[str], *passes: Pass, **more: Any) -> Cockpit:
    more = {"passes_of": lambda: passes, "source_state_of": lambda: SourceState.RUNNING} | more
    return Cockpit(clock, map_of={"bend": BEND}.get, counters=lambda: {"passages": 3}, counts=counts, **more)


async def next_line(reader: asyncio.StreamReader) -> dict[str, Any]:
    line: dict[str, Any] = json.loads(await asyncio.wait_for(reader.readline(), 10.0))
    return line


def a_pass(whereabouts: Whereabouts) -> Pass:
    return Pass("bend", whereabouts, opened=Moment(0.0, 0.0, 0.0), heard_m=0.0)


def test_a_reader_gets_the_present_state_and_then_every_change(tmp_path: Path):
    async def story() -> None:
        clock = HandClock()
        cockpit = a_cockpit(clock, Counter(), a_pass(Whereabouts.APPROACHING))
        await cockpit.open(tmp_path / "dash.sock")
        cockpit.refresh()
        reader, writer = await asyncio.open_unix_connection(tmp_path / "dash.sock")
        first = await next_line(reader)
        assert first["type"] == "state"
        assert first["v"] == 1
        assert first["sections"] == [{"section_id": "bend", "whereabouts": "approaching", "map_version": BEND.version}]
        assert first["advice"] == []
        told = await next_line(reader)
        assert told["type"] == "map"
        assert told["section"]["section_id"] == "bend"
        cockpit.show_advice("bend", ADVICE)
        clock.time_s += 10.0
        state = await next_line(reader)
        assert state["sequence"] == first["sequence"] + 1
        (advice,) = state["advice"]
        assert advice["speed_mps"] == pytest.approx(ADVICE.speed_mps)
        assert advice["valid_for_s"] == pytest.approx(ADVICE.valid_for_s)
        cockpit.withdraw("bend")
        assert (await next_line(reader))["advice"] == []
        writer.close()
        await cockpit.close()
        assert not (tmp_path / "dash.sock").exists()

    asyncio.run(story())


def test_advice_that_has_run_out_is_withdrawn_by_a_line(tmp_path: Path):
    async def story() -> None:
        clock = HandClock()
        cockpit = a_cockpit(clock, Counter())
        await cockpit.open(tmp_path / "dash.sock")
        going = asyncio.create_task(cockpit.keep_going())
        cockpit.show_advice("bend", ADVICE)
        reader, writer = await asyncio.open_unix_connection(tmp_path / "dash.sock")
        assert len((await next_line(reader))["advice"]) == 1
        clock.time_s += ADVICE.valid_for_s + 0.1
        assert (await next_line(reader))["advice"] == []
        assert cockpit.advice == ()
        going.cancel()
        writer.close()
        await cockpit.close()

    asyncio.run(story())


def test_nothing_new_is_no_line_but_a_heartbeat_is(tmp_path: Path):
    async def story() -> None:
        clock = HandClock()
        cockpit = a_cockpit(clock, Counter())
        await cockpit.open(tmp_path / "dash.sock")
        going = asyncio.create_task(cockpit.keep_going())
        reader, writer = await asyncio.open_unix_connection(tmp_path / "dash.sock")
        await next_line(reader)
        cockpit.refresh()
        clock.time_s += 5.1
        assert (await next_line(reader))["type"] == "heartbeat"
        going.cancel()
        writer.close()
        await cockpit.close()

    asyncio.run(story())


def test_counters_come_on_request_and_other_words_are_ignored(tmp_path: Path):
    async def story() -> None:
        cockpit = a_cockpit(HandClock(), Counter())
        await cockpit.open(tmp_path / "dash.sock")
        reader, writer = await asyncio.open_unix_connection(tmp_path / "dash.sock")
        await next_line(reader)
        writer.write(b"please\ncounters\n")
        line = await next_line(reader)
        assert line["type"] == "counters"
        assert line["counters"] == {"passages": 3}
        writer.write(b"x" * 1_000 + b"\n")
        assert await asyncio.wait_for(reader.read(), 10.0) == b""
        writer.close()
        await cockpit.close()

    asyncio.run(story())


def test_a_reader_that_does_not_read_is_cut_off_and_the_others_are_served(tmp_path: Path):
    async def story() -> None:
        counts: Counter[str] = Counter()
        dashboard = Dashboard(present=lambda: [{"type": "state"}], counters=dict, counts=counts)
        await dashboard.open(tmp_path / "dash.sock")
        slow = socket.socket(socket.AF_UNIX)
        slow.connect(str(tmp_path / "dash.sock"))
        reader, writer = await asyncio.open_unix_connection(tmp_path / "dash.sock")
        await next_line(reader)
        while dashboard.readers_count < 2:  # noqa: ASYNC110 - nothing tells that the other end has been seen
            await asyncio.sleep(0.01)
        for number in range(500):
            dashboard.tell({"number": number, "ballast": "x" * 2_000})
            assert (await next_line(reader))["number"] == number
        assert counts["dashboard_readers_cut_off"] == 1
        assert dashboard.readers_count == 1
        slow.close()
        writer.close()
        await dashboard.close()

    asyncio.run(story())


def test_more_readers_than_there_is_room_for_are_turned_away(tmp_path: Path):
    async def story() -> None:
        counts: Counter[str] = Counter()
        dashboard = Dashboard(present=lambda: [{"type": "state"}], counters=dict, counts=counts)
        host, port = await _tcp(dashboard)
        connections = []
        for _ in range(READERS_LIMIT_COUNT):
            connections.append(await asyncio.open_connection(host, port))
            await next_line(connections[-1][0])
        reader, writer = await asyncio.open_connection(host, port)
        with pytest.raises((ConnectionError, json.JSONDecodeError)):
            await next_line(reader)
        assert counts["dashboard_readers_turned_away"] == 1
        for _, each in [*connections, (reader, writer)]:
            each.close()
        await dashboard.close()

    asyncio.run(story())


async def _tcp(dashboard: Dashboard) -> tuple[str, int]:
    where = await dashboard.open(("127.0.0.1", 0))
    assert isinstance(where, tuple)
    return where


def test_a_socket_left_behind_is_replaced_but_never_a_file(tmp_path: Path):
    async def story() -> None:
        left = socket.socket(socket.AF_UNIX)
        left.bind(str(tmp_path / "dash.sock"))
        left.close()
        dashboard = Dashboard(present=list, counters=dict, counts=Counter())
        await dashboard.open(tmp_path / "dash.sock")
        await dashboard.close()
        (tmp_path / "file").write_text("precious")
        with pytest.raises(ConfigurationError, match="no socket"):
            await dashboard.open(tmp_path / "file")
        assert (tmp_path / "file").read_text() == "precious"

    asyncio.run(story())


@pytest.mark.parametrize(
    "text", ["tcp://0.0.0.0:1", "tcp://example.org:80", "tcp://127.0.0.1", "tcp://127.0.0.1:99999"]
)
def test_the_dashboard_is_for_this_machine_alone(text: str):
    with pytest.raises(ConfigurationError, match="local"):
        parse_dashboard_address(text)


def test_addresses_that_are_taken():
    assert parse_dashboard_address("run/dash.sock") == Path("run/dash.sock")
    assert parse_dashboard_address("tcp://127.0.0.1:4750") == ("127.0.0.1", 4750)


def test_frames_go_out_while_advice_holds_and_once_to_take_it_away():
    sent: list[tuple[ShownAdvice | None, bool]] = []

    def send(shown: ShownAdvice | None, inside: bool, now_s: float) -> bool:
        sent.append((shown, inside))
        return True

    async def story() -> None:
        clock = HandClock()
        counts: Counter[str] = Counter()
        cockpit = a_cockpit(clock, counts, a_pass(Whereabouts.INSIDE), send=send)
        going = asyncio.create_task(cockpit.keep_going())
        await asyncio.sleep(0.0)
        cockpit.show_advice("bend", ADVICE)
        for _ in range(3):
            await _one_frame_more(clock, sent)
        cockpit.withdraw("bend")
        await _one_frame_more(clock, sent)
        clock.time_s += 1.1
        await asyncio.sleep(0.3)
        assert [shown is not None for shown, _ in sent] == [True, True, True, False]
        assert sent[0][1]
        assert counts["advisory_frames"] == 4
        going.cancel()

    asyncio.run(story())


async def _one_frame_more(clock: HandClock, sent: list[Any]) -> None:
    before = len(sent)
    clock.time_s += 1.1
    while len(sent) == before:  # noqa: ASYNC110 - the loop under test goes by its own clock
        await asyncio.sleep(0.02)


def test_a_bus_that_breaks_is_said(tmp_path: Path):
    async def story() -> None:
        states = [SourceState.RUNNING]
        cockpit = a_cockpit(HandClock(), Counter(), source_state_of=lambda: states[-1])
        await cockpit.open(tmp_path / "dash.sock")
        cockpit.refresh()
        reader, writer = await asyncio.open_unix_connection(tmp_path / "dash.sock")
        assert (await next_line(reader))["source"] == "running"
        states.append(SourceState.BROKEN)
        cockpit.refresh()
        assert (await next_line(reader))["source"] == "broken"
        writer.close()
        await cockpit.close()

    asyncio.run(story())


def test_seats_that_are_held_by_nobody_who_reads_are_given_to_a_display(tmp_path: Path):
    async def story() -> None:
        counts: Counter[str] = Counter()
        dashboard = Dashboard(present=lambda: [{"type": "state"}], counters=dict, counts=counts)
        path = tmp_path / "dash.sock"
        await dashboard.open(path)
        reader, writer = await asyncio.open_unix_connection(path)
        await next_line(reader)
        storm = []
        for _ in range(20 * READERS_LIMIT_COUNT):
            storm.append(socket.socket(socket.AF_UNIX))
            storm[-1].connect(str(path))
            await asyncio.sleep(0.0)
        late_reader, late_writer = await asyncio.open_unix_connection(path)
        assert (await next_line(late_reader))["type"] == "state"
        dashboard.tell({"number": 7})
        assert (await next_line(reader))["number"] == 7
        assert (await next_line(late_reader))["number"] == 7
        assert dashboard.readers_count <= READERS_LIMIT_COUNT
        assert counts["dashboard_readers_cut_off"] > READERS_LIMIT_COUNT
        for each in storm:
            each.close()
        writer.close()
        late_writer.close()
        await dashboard.close()

    asyncio.run(story())


def test_a_storm_of_connects_that_go_at_once_leaves_every_seat_free(tmp_path: Path):
    async def story() -> None:
        dashboard = Dashboard(present=lambda: [{"type": "state"}], counters=dict, counts=Counter())
        path = tmp_path / "dash.sock"
        await dashboard.open(path)
        for _ in range(200):
            link = socket.socket(socket.AF_UNIX)
            link.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                link.connect(str(path))
            link.close()
            await asyncio.sleep(0.0)
        reader, writer = await asyncio.open_unix_connection(path)
        assert (await next_line(reader))["type"] == "state"
        writer.close()
        await dashboard.close()

    asyncio.run(story())
