import asyncio
import contextlib
import errno
import os
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from roadgrip.errors import ConfigurationError
from roadgrip.records import Advisory, Passage, Reason, Rejected
from roadgrip.section import RoadSection
from tests.vehicle_client.shell.air import ADVICE, BEND, SUMMARY, Ether, TokenCodec, Unit
from tests.vehicle_client.shell.cars import WireToUnit
from vehicle_client.shell.exchange import Ending, Exchange, FrameCodec
from vehicle_client.shell.live.attendance import Attendance, Nothing, Report, Tools, send_spooled
from vehicle_client.shell.patience import Patience
from vehicle_client.shell.spool import BootClock, Spool, SpoolError
from vehicle_client.shell.uplink import UnitAddress, Uplink

ADDRESS = UnitAddress("udp", "unit", 4740)


@dataclass
class Around:
    """A client around a conversation that keeps what it is told."""

    wire: WireToUnit
    in_reach: bool = True
    network: bool = True
    known: RoadSection | None = None
    maps: list[RoadSection] = field(default_factory=list)
    advice: list[Advisory] = field(default_factory=list)
    no_maps: list[str] = field(default_factory=list)

    def address_of(self, section_id: str) -> UnitAddress | None:
        return ADDRESS if self.in_reach else None

    @contextlib.asynccontextmanager
    async def open_uplink(self, address: UnitAddress) -> AsyncIterator[Uplink]:
        if not self.network:
            raise ConfigurationError("no network")
        yield self.wire

    def known_section(self, section_id: str) -> RoadSection | None:
        return self.known

    def take_map(self, section: RoadSection) -> None:
        self.maps.append(section)

    def take_advice(self, section_id: str, advisory: Advisory) -> None:
        self.advice.append(advisory)

    def take_no_map(self, section_id: str) -> None:
        self.no_maps.append(section_id)


class Scene:
    """One pass, its unit, and a spool on a real disk."""

    def __init__(self, folder: Path, *, lost: tuple[type, ...] = ()) -> None:
        self.ether = Ether()
        self.unit = Unit(TokenCodec(self.ether))
        self.around = Around(WireToUnit(self.unit, lost=lost))
        self.clock = BootClock()
        self.spool = Spool(folder / "spool", clock_id=self.clock.clock_id)
        self.worker = ThreadPoolExecutor(max_workers=1)
        self.tools = Tools(self, self.clock, self.clock.clock_id, self.spool, self.worker)

    def codecs_for(self, section_id: str, /) -> Callable[[bytes], FrameCodec]:
        return lambda _: TokenCodec(self.ether)

    def attendance(self) -> Attendance:
        return Attendance("bend", self.around, self.tools)

    def report(self, age_s: float = 5.0) -> Report:
        return Report(SUMMARY, BEND, left_at_s=self.clock.now_s() - age_s)

    @property
    def passages(self) -> list[Passage]:
        return [message for message in self.unit.heard if isinstance(message, Passage)]


async def until(what: Callable[[], object]) -> None:
    while not what():  # noqa: ASYNC110 - the conversation under test runs beside
        await asyncio.sleep(0.005)


def test_map_and_advice_come_first_and_the_summary_is_acknowledged(tmp_path: Path):
    async def story() -> None:
        scene = Scene(tmp_path)
        one = scene.attendance()
        running = asyncio.create_task(one.run())
        await until(lambda: scene.around.advice)
        assert [section.version for section in scene.around.maps] == [BEND.version]
        assert scene.around.advice == [ADVICE]
        assert one.section == BEND
        one.settle(scene.report())
        record = await running
        assert record.ending is Ending.ACCEPTED
        assert one.via == "udp"
        (passage,) = scene.passages
        assert passage.age_s == pytest.approx(5.0, abs=2.0)
        assert len(scene.spool) == 0

    asyncio.run(story())


def test_a_short_section_is_reported_while_the_announcement_is_still_unanswered(tmp_path: Path):
    async def story() -> None:
        scene = Scene(tmp_path)
        scene.around.known = BEND
        scene.unit.frames_left_count = 0
        one = scene.attendance()
        running = asyncio.create_task(one.run())
        await until(lambda: scene.around.wire.sent)
        scene.unit.frames_left_count = 8
        one.settle(scene.report())
        assert (await running).ending is Ending.ACCEPTED

    asyncio.run(story())


def test_without_a_unit_the_summary_waits_with_its_whole_budget(tmp_path: Path):
    async def story() -> None:
        scene = Scene(tmp_path)
        scene.around.in_reach = False
        one = scene.attendance()
        running = asyncio.create_task(one.run())
        one.settle(scene.report())
        record = await running
        assert record.may_spool
        assert one.via == "none"
        (entry,) = scene.spool.waiting()
        assert entry.frames_spent_count == 0
        assert not scene.around.wire.sent

    asyncio.run(story())


def test_without_a_network_it_is_as_if_no_unit_had_been_heard(tmp_path: Path):
    async def story() -> None:
        scene = Scene(tmp_path)
        scene.around.network = False
        one = scene.attendance()
        running = asyncio.create_task(one.run())
        one.settle(scene.report())
        assert (await running).may_spool
        assert len(scene.spool) == 1

    asyncio.run(story())


def test_a_unit_that_comes_into_reach_later_is_asked_then(tmp_path: Path):
    async def story() -> None:
        scene = Scene(tmp_path)
        scene.around.in_reach = False
        one = scene.attendance()
        running = asyncio.create_task(one.run())
        await asyncio.sleep(0.0)
        scene.around.in_reach = True
        await until(lambda: scene.around.advice)
        one.settle(scene.report())
        assert (await running).ending is Ending.ACCEPTED

    asyncio.run(story())


@pytest.mark.parametrize("why", [Reason.TOO_SLOW, None])
def test_a_pass_without_a_summary_sends_none(tmp_path: Path, why: Reason | None):
    async def story() -> None:
        scene = Scene(tmp_path)
        one = scene.attendance()
        running = asyncio.create_task(one.run())
        await until(lambda: scene.around.advice)
        one.settle(Nothing(why))
        one.settle(scene.report())  # too late: the first word counts
        assert (await running).ending is Ending.WITHHELD
        assert not scene.passages
        assert len(scene.spool) == 0

    asyncio.run(story())


def test_a_car_that_is_switched_off_while_it_sends_leaves_the_summary_with_the_frames_it_cost(tmp_path: Path):
    async def story() -> None:
        scene = Scene(tmp_path, lost=(Passage,))
        one = scene.attendance()
        running = asyncio.create_task(one.run())
        await until(lambda: scene.around.advice)
        one.settle(scene.report())
        sent = scene.around.wire.sent
        await until(lambda: len(sent) == 2)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        (entry,) = scene.spool.waiting()
        assert entry.frames_spent_count == 2

    asyncio.run(story())


def test_a_full_disk_does_not_silence_a_car_before_its_unit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    async def story() -> None:
        scene = Scene(tmp_path)
        one = scene.attendance()
        running = asyncio.create_task(one.run())
        await until(lambda: scene.around.advice)
        monkeypatch.setattr(os, "fsync", full)
        one.settle(scene.report())
        assert (await running).ending is Ending.ACCEPTED

    asyncio.run(story())


def test_a_full_disk_and_no_answer_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    async def story() -> None:
        scene = Scene(tmp_path)
        scene.around.in_reach = False
        one = scene.attendance()
        running = asyncio.create_task(one.run())
        monkeypatch.setattr(os, "fsync", full)
        one.settle(scene.report())
        with pytest.raises(SpoolError, match="No space left"):
            await running

    asyncio.run(story())


def test_a_refusal_for_good_leaves_nothing_behind(tmp_path: Path):
    async def story() -> None:
        scene = Scene(tmp_path)
        scene.unit.outcomes = [Rejected(Reason.STALE_MAP)]
        one = scene.attendance()
        running = asyncio.create_task(one.run())
        await until(lambda: scene.around.advice)
        one.settle(scene.report())
        record = await running
        assert record.ending is Ending.REJECTED
        assert len(scene.spool) == 0

    asyncio.run(story())


def test_advice_that_has_run_out_is_asked_for_again_and_shown(tmp_path: Path):
    async def story() -> None:
        scene = Scene(tmp_path)
        scene.unit.advice = replace(ADVICE, valid_for_s=0.05)
        one = scene.attendance()
        running = asyncio.create_task(one.run())
        await until(lambda: len(scene.around.advice) >= 2)
        one.settle(scene.report())
        assert (await running).ending is Ending.ACCEPTED

    asyncio.run(story())


def test_advice_is_not_asked_for_again_where_no_unit_is_in_reach(tmp_path: Path):
    async def story() -> None:
        scene = Scene(tmp_path)
        scene.unit.advice = replace(ADVICE, valid_for_s=0.05)
        one = scene.attendance()
        running = asyncio.create_task(one.run())
        await until(lambda: scene.around.advice)
        scene.around.in_reach = False
        await asyncio.sleep(0.7)
        assert len(scene.around.wire.sent) == 1
        one.settle(Nothing(None))
        await running

    asyncio.run(story())


def test_frames_are_written_down_as_spent_before_the_first_leaves(tmp_path: Path):
    async def story() -> None:
        scene = Scene(tmp_path, lost=(Passage,))
        one = scene.attendance()
        running = asyncio.create_task(one.run())
        await until(lambda: scene.around.advice)
        one.settle(scene.report())
        await until(lambda: len(scene.around.wire.sent) == 2)
        (entry,) = scene.spool.waiting()
        assert entry.frames_spent_count == 1 + Patience().report_tries_count
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running

    asyncio.run(story())


def test_a_summary_from_the_spool_has_spent_its_frames_before_the_first_leaves(tmp_path: Path):
    async def story() -> None:
        scene = Scene(tmp_path, lost=(Passage,))
        scene.around.in_reach = False
        one = scene.attendance()
        running = asyncio.create_task(one.run())
        one.settle(scene.report())
        await running
        (entry,) = scene.spool.waiting()
        codec = TokenCodec(scene.ether)
        exchange = Exchange(passage_id=entry.passage_id, section_id="bend", codec=codec)
        sending = asyncio.create_task(
            send_spooled(entry, exchange, scene.around.wire, scene.tools, map_version=BEND.version, left_at_s=0.0)
        )
        await until(lambda: scene.around.wire.sent)
        (held,) = scene.spool.waiting()
        assert held.frames_spent_count == Patience().report_tries_count
        sending.cancel()
        with pytest.raises(asyncio.CancelledError):
            await sending

    asyncio.run(story())
