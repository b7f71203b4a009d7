"""The one way into the unit for passages, whatever transport they came by: bounded, timed, counted, logged."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from functools import lru_cache, partial
from typing import NamedTuple, TypeVar

import structlog

from roadgrip.bundle import BundleManifest
from roadgrip.reasons import Reason
from roadgrip.records import Accepted, NotCounted, Outcome, Passage, Rejected
from roadgrip.units import FloatArray
from rsu_app.observability import Metrics
from rsu_app.ports import Estimates, FrictionModel
from rsu_app.rate import RateLimit
from rsu_app.usecases import AcceptedAgain, RoadSideUnit

_log = structlog.get_logger("roadgrip")
T = TypeVar("T")

BATCH_COUNT = 128
"""Passages that are judged together at most: some milliseconds, in which the event loop does nothing else."""
TURN_S = 0.1
"""A batch that takes longer than this, for the disk's sake, keeps the next from beginning no more."""


class _Waiting(NamedTuple):
    passage: Passage
    via: str
    since_s: float
    answer: Callable[[Outcome | Exception], object]


class PassageIntake:
    """Hands passages to the unit, not more at one time than it can bear.

    One batch is in work at a time, and what arrives meanwhile is the next: the busier the unit, the larger its batches
    and the cheaper each passage. A passage that arrives alone is begun with at once.

    Args:
        unit: What judges and keeps them.
        metrics: Where outcomes are counted.
        in_flight_limit_count: Passages in work at one time; more are refused as busy.
        lines_per_s: Passages whose canonical line is written, per second; the others are counted as lines dropped.
        now_s: A monotonic clock of the machine, also when the unit's own is accelerated: latency is real.
    """

    def __init__(
        self,
        unit: RoadSideUnit,
        *,
        metrics: Metrics,
        in_flight_limit_count: int,
        lines_per_s: float = 1_000.0,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._unit = unit
        self._metrics = metrics
        self._limit_count = in_flight_limit_count
        self._in_flight_count = 0
        self._lines = RateLimit(lines_per_s)
        self._now_s = now_s
        self._waiting: list[_Waiting] = []
        self._working: set[asyncio.Task[None]] = set()
        self._turn: asyncio.Handle | None = None
        # Bound once: binding a logger for every passage would cost as much as decoding one.
        self._log = _log.bind()

    @property
    def in_flight_count(self) -> int:
        """Passages that came and are not answered yet."""
        return self._in_flight_count

    @property
    def full(self) -> bool:
        """Whether the next passage would be refused as busy."""
        return self._in_flight_count >= self._limit_count

    async def receive(self, passage: Passage, *, via: str) -> Outcome:
        """Return what became of a passage; it is on the disk when it was accepted.

        Args:
            passage: What a vehicle claims.
            via: The transport, "udp", "http" or "json".
        """
        outcome: asyncio.Future[Outcome] = asyncio.get_running_loop().create_future()
        self.offer(passage, via=via, answer=into(outcome, lambda told: told))
        return await outcome

    def offer(self, passage: Passage, *, via: str, answer: Callable[[Outcome | Exception], object]) -> None:
        """Let `answer` hear once what became of a passage, or which bug it met; see `receive`.

        For who does not wait: thousands of passages a second need no future each.
        """
        waiting = _Waiting(passage, via, self._now_s(), answer)
        if self.full:
            self._tell(waiting, Rejected(Reason.BUSY, f"{self._limit_count} passages are in work"))
            return
        self._in_flight_count += 1
        self._waiting.append(waiting)
        if self._turn is None:
            self._turn = asyncio.get_running_loop().call_soon(self._begin)

    def _begin(self) -> None:
        """Begin with a batch of those who wait; the next begins when it has ended, or takes too long."""
        if not self._waiting:
            self._turn = None
            return
        loop = asyncio.get_running_loop()
        batch, self._waiting = self._waiting[:BATCH_COUNT], self._waiting[BATCH_COUNT:]
        task = loop.create_task(self._work(batch))
        self._working.add(task)
        turn = self._turn = loop.call_later(TURN_S, self._begin)
        task.add_done_callback(partial(self._end, turn))

    def _end(self, turn: asyncio.Handle, task: asyncio.Task[None]) -> None:
        self._working.discard(task)
        if turn is self._turn:  # or others have begun meanwhile
            turn.cancel()
            # After the sockets were read once more: what came meanwhile belongs to the next batch.
            self._turn = asyncio.get_running_loop().call_soon(self._begin)

    async def _work(self, batch: list[_Waiting]) -> None:
        """Answer everybody in a batch."""
        try:
            outcomes = await self._unit.ingest_passages([waiting.passage for waiting in batch])
        except Exception as error:  # noqa: BLE001 - a bug that one passage meets must not leave others without an answer
            if len(batch) == 1:
                self._in_flight_count -= 1
                self._fail(batch[0], error)
                return
            for waiting in batch:
                await self._work([waiting])
            return
        self._in_flight_count -= len(batch)
        for waiting, outcome in zip(batch, outcomes, strict=True):
            self._tell(waiting, outcome)

    def _tell(self, waiting: _Waiting, outcome: Outcome) -> None:
        duration_s = self._now_s() - waiting.since_s
        self._metrics.ingest_duration.observe(duration_s)
        self.note(waiting.passage, outcome, via=waiting.via, duration_s=duration_s)
        try:
            waiting.answer(outcome)
        except Exception as error:  # noqa: BLE001 - nor must an answer that cannot be written keep others from theirs
            self._note_bug(waiting, error)

    def _fail(self, waiting: _Waiting, error: Exception) -> None:
        self._note_bug(waiting, error)
        waiting.answer(error)

    def _note_bug(self, waiting: _Waiting, error: Exception) -> None:
        self._log.error("bug", passage=waiting.passage.passage_id.hex(), via=waiting.via, error=repr(error))

    def note(self, passage: Passage, outcome: Outcome, *, via: str, duration_s: float = 0.0) -> None:
        """Count an outcome and write its canonical line."""
        if isinstance(outcome, Accepted):
            # Compared with `is`: a flag's own ways of being asked take longer than all else here.
            counted = outcome.flags is NotCounted.NONE
            verdict, reason = ("counted", "") if counted else ("uncounted", flag_names(outcome.flags))
            if isinstance(outcome, AcceptedAgain):
                verdict = "repeated"
        else:
            verdict, reason = "rejected", outcome.reason.value
        section = self._metrics.section_label(passage.section_id)
        if isinstance(outcome, Rejected):
            self._metrics.latest_refusals.note(
                reason=reason, section=section, via=via, detail=outcome.detail, now_s=self._now_s()
            )
        self._metrics.passages.count(section, verdict, reason, via)
        if not self._lines.take(now_s=self._now_s()):
            # Asked here and not by the log's own budget: a line that nobody will read should not be composed.
            self._metrics.log_lines_dropped.count()
            return
        self._log.info(
            "passage",
            section=section,
            passage=passage.passage_id.hex(),
            outcome=verdict,
            reason=reason,
            detail=outcome.detail[:200] if isinstance(outcome, Rejected) else "",
            via=via,
            age_s=passage.age_s,
            passage_duration_s=passage.summary.duration_s,
            quality=int(passage.summary.quality),
            took_s=round(duration_s, 6),
        )


def into(future: asyncio.Future[T], made_of: Callable[[Outcome], T]) -> Callable[[Outcome | Exception], None]:
    """Return what lets a future hold what is made of an outcome, or the bug, unless nobody waits for it any more."""

    def answer(outcome: Outcome | Exception) -> None:
        if future.done():
            return
        if isinstance(outcome, Exception):
            future.set_exception(outcome)
            return
        try:
            future.set_result(made_of(outcome))
        except Exception as error:  # noqa: BLE001 - whoever waits must hear of it
            future.set_exception(error)

    return answer


class TimedModel:
    """A friction model that tells how long it takes."""

    def __init__(self, model: FrictionModel, *, metrics: Metrics) -> None:
        """Wrap a model."""
        self._model = model
        self._observe = metrics.inference_duration.observe

    @property
    def manifest(self) -> BundleManifest:
        """What the bundle says about itself."""
        return self._model.manifest

    def estimate(self, table_digest: str, rows: FloatArray, *, section_id: str | None = None) -> Estimates:
        """Return the friction estimate of each row, see `rsu_app.ports.FrictionModel`."""
        started_s = time.perf_counter()
        try:
            return self._model.estimate(table_digest, rows, section_id=section_id)
        finally:
            self._observe(time.perf_counter() - started_s)


@lru_cache(maxsize=64)
def flag_names(flags: NotCounted) -> str:
    """Return why a passage does not count, as one label such as `older_than_window`."""
    return "+".join((flag.name or "").lower() for flag in NotCounted if flag and flag in flags)
