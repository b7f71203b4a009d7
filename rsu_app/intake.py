"""The one way into the unit for passages, whatever transport they came by: bounded, timed, counted, logged."""

from __future__ import annotations

import time
from collections.abc import Callable

import structlog

from roadgrip.bundle import BundleManifest
from roadgrip.reasons import Reason
from roadgrip.records import Accepted, NotCounted, Outcome, Passage, Rejected
from roadgrip.units import FloatArray
from rsu_app.observability import Metrics
from rsu_app.ports import Estimates, FrictionModel
from rsu_app.usecases import AcceptedAgain, RoadSideUnit

_log = structlog.get_logger("roadgrip")


class PassageIntake:
    """Hands passages to the unit, not more at one time than it can bear.

    Args:
        unit: What judges and keeps them.
        metrics: Where outcomes are counted.
        in_flight_limit_count: Passages in work at one time; more are refused as busy.
        now_s: A monotonic clock of the machine, also when the unit's own is accelerated: latency is real.
    """

    def __init__(
        self,
        unit: RoadSideUnit,
        *,
        metrics: Metrics,
        in_flight_limit_count: int,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._unit = unit
        self._metrics = metrics
        self._limit_count = in_flight_limit_count
        self._in_flight_count = 0
        self._now_s = now_s

    async def receive(self, passage: Passage, *, via: str) -> Outcome:
        """Return what became of a passage; it is on the disk when it was accepted.

        Args:
            passage: What a vehicle claims.
            via: The transport, "udp", "http" or "json".
        """
        started_s = self._now_s()
        if self._in_flight_count >= self._limit_count:
            outcome: Outcome = Rejected(Reason.BUSY, f"{self._limit_count} passages are in work")
        else:
            self._in_flight_count += 1
            self._metrics.in_flight.set(self._in_flight_count)
            try:
                outcome = await self._unit.ingest_passage(passage)
            finally:
                self._in_flight_count -= 1
                self._metrics.in_flight.set(self._in_flight_count)
        duration_s = self._now_s() - started_s
        self._metrics.ingest_duration.observe(duration_s)
        self.note(passage, outcome, via=via, duration_s=duration_s)
        return outcome

    def note(self, passage: Passage, outcome: Outcome, *, via: str, duration_s: float = 0.0) -> None:
        """Count an outcome and write its canonical line."""
        if isinstance(outcome, Accepted):
            verdict, reason = "counted" if outcome.counted else "uncounted", flag_names(outcome.flags)
            if isinstance(outcome, AcceptedAgain):
                verdict = "repeated"
        else:
            verdict, reason = "rejected", outcome.reason.value
        section = self._metrics.section_label(passage.section_id)
        self._metrics.passages.labels(section, verdict, reason, via).inc()
        _log.info(
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


def flag_names(flags: NotCounted) -> str:
    """Return why a passage does not count, as one label such as `older_than_window`."""
    return "+".join((flag.name or "").lower() for flag in NotCounted if flag and flag in flags)
