"""What the appliance was to reach, and which measured figure is held against it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from bench.appliance.peers import PEERS

Figures = Mapping[str, Any]
"""What the parts have measured, by the name of the part."""


@dataclass(frozen=True, slots=True)
class Target:
    """One of them.

    Attributes:
        key: Name of the figure in `bench.json`.
        meaning: For people.
        limit: What it must reach.
        at_least: Whether more is better.
        number_format: How figure and limit are written.
        unit: Behind them.
    """

    key: str
    meaning: str
    limit: float
    at_least: bool
    number_format: str = ",.0f"
    unit: str = ""

    def met(self, figure: float) -> bool:
        """Return whether a figure reaches it."""
        return figure >= self.limit if self.at_least else figure <= self.limit

    def written(self, figure: float) -> str:
        """Return a figure as a table shows it."""
        return f"{figure:{self.number_format}}{self.unit}"


REFERENCE_BARE_PER_S = 11_700
"""What the barest server took per second and core on the machine that the targets were set on.

On another machine, or at another hour of a rented one, a target in passages per second says what the machine is worth;
the ratio to the barest server, measured in turns with it, says what the unit is."""
TARGETS = (
    Target("udp_passages_per_s_per_core", "passages over UDP", 5_000, at_least=True),
    Target(
        "udp_times_bare",
        "cost of a passage against the barest server that asks the model and keeps the bytes",
        REFERENCE_BARE_PER_S / 5_000,
        at_least=False,
        number_format=".1f",
        unit="×",
    ),
    Target("udp_signed_passages_per_s_per_core", "the same, signed both ways", 2_500, at_least=True),
    Target("p99_ms_at_1000", "last frame to receipt at 1,000/s, 99 %", 25, at_least=False, unit=" ms"),
    Target("recovery_s", "as before again after a tenfold overload", 5, at_least=False, number_format=".2f", unit=" s"),
    Target("http_frames_per_s_per_core", "passages over HTTP, frames", 2_000, at_least=True),
    Target("http_json_per_s_per_core", "passages over HTTP, JSON", 1_200, at_least=True),
    Target("reads_per_s_per_core", "reads, advisory and map in turn", 4_000, at_least=True),
    *(
        Target(
            f"{way}_times_{peer.key}",
            f"{name} against {peer.name}",
            limit,
            at_least=True,
            number_format=".1f",
            unit="×",
        )
        for way, name, limit in (("http", "HTTP", 4), ("udp", "UDP, another transport,", 10))
        for peer in PEERS
    ),
    Target("rss_mb", "memory with 100,000 passages in the window", 150, at_least=False, unit=" MB"),
    Target("ready_s", "start to ready", 2, at_least=False, number_format=".2f", unit=" s"),
    Target("idle_cpu_frac", "processor time of the idle unit", 0.01, at_least=False, number_format=".2%"),
    Target(
        "window_cost_ratio", "cost of a passage, full against empty window", 1.1, at_least=False, number_format=".2f"
    ),
    Target("install_mb", "installed size", 250, at_least=False, unit=" MB"),
)
_PYTHON = (
    "half of it is Python that checks, remembers and answers, a little of everything and no single place ([beside the "
    "barest server](#beside-the-barest-server)); next: read, judge and answer a batch as arrays, from the datagrams on"
)
_PEERS = (
    "two models and a commit against one model and none, on a machine that serves the peers faster than the one the "
    "target was set on (MLServer took some 400 there); next: what the cost of a passage needs"
)
_HTTP = (
    "as over UDP, and the 64 connections come in two halves, so that batches have 32; what is measured changes twofold "
    "with the minute of this machine; next: what the cost of a passage needs"
)
MISSES: Mapping[str, str] = {
    "udp_passages_per_s_per_core": _PYTHON,
    "udp_times_bare": _PYTHON,
    "udp_signed_passages_per_s_per_core": "a signature verified and one made come on top of what an unsigned passage "
    "costs; next: the same, and receipts of a batch under one signature",
    "p99_ms_at_1000": "met in the quick minutes of this machine only: in its slow ones 1,000 a second in batches of "
    "four are all that a core does, since each batch comes to cold caches, and passages queue; the barest server in "
    "turns with it has room left ([beside the barest server](#beside-the-barest-server)); a pause before the next "
    "batch was tried and makes everybody wait longer; next: fewer calls of array functions for small batches, and a "
    "thread of its own that copies SQLite's log",
    "recovery_s": "what the kernel had kept of the flood is worked off within some seconds, as long as the unit can be "
    "faster than what still arrives; next: what the cost of a passage needs",
    "http_frames_per_s_per_core": _HTTP,
    "http_json_per_s_per_core": _HTTP,
    **{f"{way}_times_{peer.key}": _PEERS for way in ("udp", "http") for peer in PEERS},
    "rss_mb": "most of it is there before the first passage ([what it consists of](#start)), 26 MB are the windows and "
    "what is remembered of passages; next: SQLAlchemy into the tools that migrate, and out of the unit",
    "install_mb": "54 MB of it are bytecode, which pip makes; the Debian package has 191 MB with its bytecode, since "
    "it leaves out what a unit never runs",
}
"""Why a target was missed and what comes next, by its key: written by whoever looked into it, shown on the page."""
IMPORT_MORE_S = 0.5
"""Start to ready may also take as long as the imports and this."""


def headline(parts: Figures) -> dict[str, float]:
    """Return the figures that targets are held against, as far as their parts were measured.

    Args:
        parts: Figures by part; see `bench.appliance.load` and its neighbours.
    """
    figures: dict[str, float] = {}
    for key, find in _FOUND.items():
        try:
            found = find(parts)
        except KeyError:
            continue
        if found is not None:
            figures[key] = found
    for way, times in parts.get("peers", {}).get("times", {}).items():
        figures |= {f"{way}_times_{key}": ratio for key, ratio in times.items()}
    return figures


def ready_limit_s(parts: Figures) -> float:
    """Return how long a start may take: two seconds, or the imports and half a second."""
    (target,) = (target for target in TARGETS if target.key == "ready_s")
    return max(target.limit, float(parts["start"]["import_s"]) + IMPORT_MORE_S)


_FOUND: Mapping[str, Callable[[Figures], float | None]] = {
    "udp_passages_per_s_per_core": lambda p: p["udp"]["passages_per_s_per_core"],
    "udp_times_bare": lambda p: p["bare"]["times_bare"],
    "bare_passages_per_s_per_core": lambda p: 1e6 / p["bare"]["bare_us"],
    "udp_signed_passages_per_s_per_core": lambda p: p["signed"]["passages_per_s_per_core"],
    "udp_signed_new_certificate_per_s_per_core": lambda p: p["signed"]["certificate_never_seen"][
        "passages_per_s_per_core"
    ],
    "p99_ms_at_1000": lambda p: p["udp"]["paced"]["latency_q99_ms"],
    "recovery_s": lambda p: p["udp"]["overload"]["after"]["recovered_after_s"],
    "http_frames_per_s_per_core": lambda p: p["http"]["frames"]["requests_per_s_per_core"],
    "http_json_per_s_per_core": lambda p: p["http"]["json"]["requests_per_s_per_core"],
    "reads_per_s_per_core": lambda p: p["http"]["reads"]["requests_per_s_per_core"],
    "rss_mb": lambda p: p["window"]["rss_mb"],
    "idle_cpu_frac": lambda p: p["window"]["idle_cpu_frac"],
    "window_cost_ratio": lambda p: p["window"]["cost_last_to_first_quarter_ratio"],
    "ready_s": lambda p: p["start"]["ready_s"],
    "import_s": lambda p: p["start"]["import_s"],
    "install_mb": lambda p: p["install"]["install_mb"],
}
