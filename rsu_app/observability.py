"""What the unit tells its operator: log lines on standard output, and metrics for Prometheus.

One canonical line is written for every passage, with everything one would ask about it. Log volume has a budget:
above it lines are dropped and counted, since a unit whose disk is full of complaints serves nobody.
`deploy/README.md` holds the table that `metrics_table` makes; a test keeps the two alike.
"""

from __future__ import annotations

import logging
import platform
import sys
import time
from bisect import bisect_left
from collections.abc import Callable, MutableMapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from math import inf, nan
from typing import TYPE_CHECKING, Any, Literal

import structlog
from prometheus_client import CollectorRegistry, Counter, Gauge, disable_created_metrics, generate_latest
from prometheus_client.core import HistogramMetricFamily
from prometheus_client.process_collector import ProcessCollector
from prometheus_client.registry import Collector
from prometheus_client.utils import floatToGoString

from rsu_app.latest_refusals import LatestRefusals
from rsu_app.rate import RateLimit

if TYPE_CHECKING:
    from collections.abc import Iterable

    from prometheus_client import Metric

OTHER_SECTION = "other"
"""Label of a section this unit does not serve: a sender must not be able to make labels."""

_LATENCY_BUCKETS_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
_INFERENCE_BUCKETS_S = (1e-5, 2.5e-5, 5e-5, 1e-4, 2.5e-4, 5e-4, 1e-3, 2.5e-3, 5e-3, 1e-2, 0.1)


disable_created_metrics()  # type: ignore[no-untyped-call] # a series per series that says when it began doubles the answer and nobody reads it


class _Counter(Counter):
    """A counter whose series are counted in a dictionary, and brought up to date when somebody reads them.

    The library's own way takes as long as parsing a frame, and each passage counts some seven things. Labels come
    from closed sets, so the dictionary stays small. To be counted and read by one thread.
    """

    def count(self, *labels: str, by: int = 1) -> None:
        """Count one more, or several, of the series with these labels."""
        tally = self._tally
        tally[labels] = tally.get(labels, 0) + by

    def collect(self) -> Iterable[Metric]:
        """Return all series as they stand."""
        while self._tally:
            labels, number = self._tally.popitem()
            (self.labels(*labels) if labels else self).inc(number)
        return super().collect()

    @cached_property
    def _tally(self) -> dict[tuple[str, ...], int]:
        return {}


class _Histogram(Collector):
    """A histogram of one series of durations; the library's own goes through its buckets one by one for each.

    Args:
        name: Of the metric.
        meaning: For people.
        limits: Upper ends of its buckets but the last, which has none.
    """

    def __init__(self, name: str, meaning: str, limits: tuple[float, ...]) -> None:
        self._name = name
        self._meaning = meaning
        self._limits = limits
        self._counts = [0] * (len(limits) + 1)
        self._sum = 0.0

    def observe(self, took_s: float) -> None:
        """Count a measurement."""
        self._counts[bisect_left(self._limits, took_s)] += 1
        self._sum += took_s

    def collect(self) -> Iterable[Metric]:
        """Return the buckets as they stand."""
        ends = [floatToGoString(limit) for limit in (*self._limits, inf)]  # type: ignore[no-untyped-call]
        buckets = list(zip(ends, accumulate(self._counts), strict=True))
        yield HistogramMetricFamily(self._name, self._meaning, buckets=buckets, sum_value=self._sum)


class Metrics:
    """Every metric of the unit, in a registry of its own.

    Labels come from closed sets (sections served, reason codes, message types), so that no sender can make series.
    """

    def __init__(self, *, version: str, section_ids: Iterable[str]) -> None:
        """Register everything, so that a series shows zero before it shows one."""
        self.registry = CollectorRegistry()
        self._section_ids = frozenset(section_ids)
        self._made: list[MetricRow] = []
        self.latest_refusals = LatestRefusals()
        ProcessCollector(registry=self.registry)

        self.build_info = self._gauge("roadgrip_build_info", "1; the labels say what runs.", "version", "python")
        self.build_info.labels(version, platform.python_version()).set(1)
        self.ready = self._gauge("roadgrip_ready", "1 while the unit is ready, as `/health/ready` says.")
        self.passages = self._counter(
            "roadgrip_passages_total",
            "Passages answered, by outcome (`counted`, `uncounted`, `rejected`; `repeated`: accepted before), "
            "reason and way.",
            "section",
            "outcome",
            "reason",
            "via",
        )
        self.ingest_duration = self._histogram(
            "roadgrip_ingest_duration_seconds", "From a whole passage to its committed outcome.", _LATENCY_BUCKETS_S
        )
        self.inference_duration = self._histogram(
            "roadgrip_inference_duration_seconds", "Time of one call of the model.", _INFERENCE_BUCKETS_S
        )
        self.in_flight = self._gauge("roadgrip_ingest_in_flight", "Passages in work.")
        self.store_queue = self._gauge("roadgrip_store_queue_depth", "Passages that wait for a commit.")
        self.store_passages = self._gauge("roadgrip_store_passages", "Passages in the database.")
        self.store_size = self._gauge("roadgrip_store_bytes", "Size of the database with its write-ahead log.")
        self.frames_received = self._counter("roadgrip_frames_received_total", "Frames that came in.", "via")
        self.frames_sent = self._counter("roadgrip_frames_sent_total", "Frames sent.", "via", "message")
        self.frames_dropped = self._counter(
            "roadgrip_frames_dropped_total", "Frames that led to nothing, by reason.", "via", "reason"
        )
        self.frames_withheld = self._counter(
            "roadgrip_frames_withheld_total", "Frames not sent because a budget was used up.", "message"
        )
        self.frame_duplicates = self._counter("roadgrip_frame_duplicates_total", "Frames that had come before.", "via")
        self.messages_received = self._counter(
            "roadgrip_messages_received_total", "Whole messages that came in.", "via", "message"
        )
        self.assemblies = self._gauge("roadgrip_assemblies", "Incomplete messages kept.")
        self.assemblies_given_up = self._gauge(
            "roadgrip_assemblies_given_up", "Incomplete messages forgotten since the start, for age or for room."
        )
        self.exchanges = self._gauge("roadgrip_exchanges", "Passages whose frame budget is remembered.")
        self.exchanges_evicted = self._gauge(
            "roadgrip_exchanges_evicted",
            "Passages whose frame budget was forgotten early since the start, for newer ones.",
        )
        self.refusals_withheld = self._counter(
            "roadgrip_refusals_withheld_total", "Rejections not sent because of `frames.refusals_per_s`."
        )
        self.detections = self._counter(
            "roadgrip_detections_total", "Vehicles reported by a loop or a camera.", "section"
        )
        self.mu_low = self._gauge("roadgrip_interval_mu_low", "Lower end of the friction interval.", "section")
        self.mu_new = self._gauge("roadgrip_interval_mu_new", "Upper end of the friction interval.", "section")
        self.median_mu = self._gauge("roadgrip_interval_median_mu", "Median of the counted estimates.", "section")
        self.at_least = self._gauge(
            "roadgrip_interval_at_least",
            "1 while so few vehicles name a friction that the interval is marked and the advice held.",
            "section",
        )
        self.window_passages = self._gauge("roadgrip_window_passages", "Counted passages in the window.", "section")
        self.advisory_speed = self._gauge("roadgrip_advisory_speed_mps", "Advised speed.", "section")
        self.stream_clients = self._gauge("roadgrip_stream_clients", "Open event streams.")
        self.http_requests = self._counter(
            "roadgrip_http_requests_total", "Requests by route and status.", "route", "status"
        )
        self.http_refusals = self._counter(
            "roadgrip_http_refusals_total",
            "Connections that were refused or let go, and requests without the right to ask, by reason.",
            "reason",
        )
        self.certificate_days = self._gauge(
            "roadgrip_http_certificate_days", "Days until the certificate of HTTPS ends; NaN without one."
        )
        self.certificate_days.set(nan)
        self.bundle = self._gauge(
            "roadgrip_bundle_info",
            "1; the labels say which bundle is `live`, `previous` or `candidate`.",
            "role",
            "bundle",
        )
        self.update_refusals = self._counter(
            "roadgrip_update_refusals_total", "Releases and steps of a rollout that were refused, by reason.", "reason"
        )
        self.rollout_stage = self._gauge(
            "roadgrip_rollout_stage", "1 for how far the newest release has come.", "stage"
        )
        self.shadow_passages = self._gauge(
            "roadgrip_shadow_passages", "Passages that two bundles were compared by; 0 with a single one."
        )
        self.shadow_failures = self._gauge(
            "roadgrip_shadow_failures", "Passages that the newer of them left without an answer."
        )
        self.shadow_median = self._gauge(
            "roadgrip_shadow_median_ratio", "Median difference of the newer to the older, of ln mu."
        )
        self.shadow_spread = self._gauge(
            "roadgrip_shadow_spread_ratio", "What nine differences in ten stay below, of ln mu."
        )
        self.drift_psi = self._gauge(
            "roadgrip_drift_psi_ratio",
            "Population stability index of a feature against the training's reference, or of the estimate `mu`.",
            "section",
            "feature",
        )
        self.drift_ks = self._gauge(
            "roadgrip_drift_ks_frac",
            "Kolmogorov-Smirnov distance of a feature against the training's reference, or of the estimate `mu`.",
            "section",
            "feature",
        )
        self.drift_moved = self._gauge(
            "roadgrip_drift_own_moved_frac",
            "Share of the features that moved against the section's own earlier traffic of like friction.",
            "section",
        )
        self.drift_outside = self._gauge(
            "roadgrip_drift_out_of_envelope_frac", "Share of the passages outside the model's envelope.", "section"
        )
        self.drift_alarm = self._gauge(
            "roadgrip_drift_alarm", "1 while somebody should look at the section, by what for.", "section", "alarm"
        )
        self._register_vital_signs()
        self.log_lines_dropped = self._counter(
            "roadgrip_log_lines_dropped_total", "Log lines above the budget `log.lines_limit_per_s`."
        )

    def _register_vital_signs(self) -> None:
        """Register what tells of the box rather than of its road."""
        self.signing_certificate_ends = self._gauge(
            "roadgrip_signing_certificate_ends_unix_seconds",
            "When the certificate ends by which the unit signs; NaN without one.",
        )
        self.signing_certificate_ends.set(nan)
        self.condition_ok = self._gauge(
            "roadgrip_condition_ok", "1 while a condition of `/health/ready` holds; the window is no need.", "condition"
        )
        self.commit_age = self._gauge(
            "roadgrip_store_commit_age_seconds",
            "Since the last commit that reached the disk; NaN before the first and after a failure.",
        )
        self.writer_busy = self._gauge(
            "roadgrip_store_writer_busy_seconds", "How long the same writes have been under way; 0 without any."
        )
        self.damaged_kept = self._gauge(
            "roadgrip_store_damaged_kept", "Damaged databases that were moved aside and still lie there."
        )
        self.disk_free = self._gauge("roadgrip_disk_free_bytes", "Room left where the database is.")
        self.disk_size = self._gauge("roadgrip_disk_size_bytes", "Size of the file system where the database is.")
        self.memory_limit = self._gauge(
            "roadgrip_memory_limit_bytes", "Memory that the process may take; NaN without a limit."
        )
        self.udp_kernel_drops = self._gauge(
            "roadgrip_udp_kernel_drops", "Datagrams that the kernel dropped since the start, for want of room."
        )
        self.clock_steps = self._counter("roadgrip_clock_steps_total", "Steps of the wall clock that were seen.")
        self.clock_synchronised = self._gauge(
            "roadgrip_clock_synchronised", "1 while the kernel says that something keeps the wall clock right."
        )
        self.clock_max_error = self._gauge(
            "roadgrip_clock_max_error_seconds", "How wrong it may be at most, by the kernel's account."
        )

    def section_label(self, section_id: str) -> str:
        """Return the section's id if the unit serves it, or `other`."""
        return section_id if section_id in self._section_ids else OTHER_SECTION

    def passage_counts(self) -> list[tuple[dict[str, str], int]]:
        """Return how many passages were answered since the start, for each set of labels."""
        return [
            (sample.labels, int(sample.value))
            for family in self.passages.collect()
            for sample in family.samples
            if sample.name.endswith("_total")
        ]

    def log_lines_dropped_count(self) -> float:
        """Return how many log lines were above the budget since the start."""
        return self.registry.get_sample_value("roadgrip_log_lines_dropped_total") or 0.0

    def exposition(self) -> bytes:
        """Return all metrics in the text format of Prometheus."""
        return generate_latest(self.registry)

    def rows(self) -> tuple[MetricRow, ...]:
        """Return every metric of ours as the documentation shows it."""
        return tuple(self._made)

    def _counter(self, name: str, meaning: str, *labels: str) -> _Counter:
        self._made.append(MetricRow(name, "counter", labels, meaning))
        return _Counter(name, meaning, labels, registry=self.registry)

    def _gauge(self, name: str, meaning: str, *labels: str) -> Gauge:
        self._made.append(MetricRow(name, "gauge", labels, meaning))
        return Gauge(name, meaning, labels, registry=self.registry)

    def _histogram(self, name: str, meaning: str, buckets: tuple[float, ...]) -> _Histogram:
        self._made.append(MetricRow(name, "histogram", (), meaning))
        histogram = _Histogram(name, meaning, buckets)
        self.registry.register(histogram)
        return histogram


@dataclass(frozen=True, slots=True)
class MetricRow:
    """One metric as the documentation shows it."""

    name: str
    kind: str
    labels: tuple[str, ...]
    meaning: str


def metrics_table() -> str:
    """Return the table of all metrics as Markdown, as `deploy/README.md` holds it."""
    lines = ["| metric | type | labels | meaning |", "|---|---|---|---|"]
    for row in Metrics(version="", section_ids=()).rows():
        labels = ", ".join(f"`{label}`" for label in row.labels)
        lines.append(f"| `{row.name}` | {row.kind} | {labels} | {row.meaning} |")
    return "\n".join(lines) + "\n"


class LineBudget:
    """A structlog processor that drops lines above so many a second, and counts them."""

    def __init__(
        self, lines_limit_per_s: float, on_drop: Callable[[], None], now_s: Callable[[], float] = time.monotonic
    ) -> None:
        """Start with one second's worth of lines."""
        self._limit = RateLimit(lines_limit_per_s)
        self._on_drop = on_drop
        self._now_s = now_s

    def __call__(self, _logger: object, method: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
        """Return the event, or drop it; warnings and worse always pass."""
        if method in {"warning", "error", "critical", "exception"} or self._limit.take(now_s=self._now_s()):
            return event
        self._on_drop()
        raise structlog.DropEvent


def configure_logging(
    *,
    level: str,
    style: Literal["json", "text"],
    lines_limit_per_s: float,
    on_drop: Callable[[], None],
) -> None:
    """Send the log lines of this process, and those of the libraries, to standard output in one form."""
    shared: list[structlog.typing.Processor] = [
        structlog.stdlib.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True, key="at"),
    ]
    final: list[structlog.typing.Processor] = (
        [structlog.processors.dict_tracebacks, structlog.processors.JSONRenderer()]
        if style == "json"
        else [structlog.dev.ConsoleRenderer(colors=sys.stdout.isatty())]
    )
    severity = getattr(logging, level.upper())
    structlog.configure(
        processors=[LineBudget(lines_limit_per_s, on_drop), *shared, *final],
        wrapper_class=structlog.make_filtering_bound_logger(severity),
        logger_factory=structlog.WriteLoggerFactory(file=sys.stdout),
        cache_logger_on_first_use=False,
    )
    handler = logging.StreamHandler(sys.stdout)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=[*shared, structlog.stdlib.add_logger_name],
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *final],
        )
    )
    root = logging.getLogger()
    root.handlers = [handler]
    root.setLevel(max(severity, logging.WARNING))
