"""The page of the appliance's figures, made from them alone."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.appliance.load import BIN_S, LATENCY_LIMIT_S, OVERLOAD_TIMES, PACE_PER_S
from bench.appliance.peers import PEERS
from bench.appliance.targets import IMPORT_MORE_S, MISSES, REFERENCE_BARE_PER_S, TARGETS, Target, ready_limit_s
from bench.measurement import table_of
from bench.validation.picture import OURS, THEORY, label, line, panels, write

PAGE_NAME = "bench.md"
WINDOW_PICTURE, OVERLOAD_PICTURE = "bench-window", "bench-overload"
LARGEST_PACKAGES_COUNT = 8
LINE_CHARS = 125
_MODELS = ("friction_model_64_rows_us", "error_model_64_rows_us")

HEAD = """# Speed and size of the road side unit

Made by `make appliance-bench`, not by hand; the figures are in [bench.json](bench.json). A part alone:
`make appliance-bench ARGS="udp http"`; a look in two minutes: `ARGS=--quick`.

The unit is the real daemon, `roadgrip-rsu serve`, with the packaged bundle and six sections (the packaged ones, and the
same roads under other names), its database on a disk, every commit with `synchronous=FULL`. A passage counts when its
receipt says that it was accepted, which it says after the commit that holds it: it has then been checked, put together,
judged by both models (friction, and its expected error), stored, and entered in the window. Every passage is one that
the unit has not seen: the packaged bundle's golden drives, varied. The unit runs on one core and the load comes from
the
other. **Per core** is per second of processor time of the unit's process, all its threads, in user and kernel mode.
"""

_PASSAGE_BUYS = (
    "checksums and reassembly, frame budgets, plausibility of 115 numbers, the envelope of ordinary driving, memory of "
    "repetitions and replays, the window with interval and advice, metrics, a log line, the receipt"
)


def write_page(results: Mapping[str, Any], folder: Path) -> str:
    """Write the page and its pictures, and return the table of targets.

    Args:
        results: What `bench.json` holds.
        folder: Where page and pictures go.
    """
    parts = results["parts"]
    table = targets_table(results)
    chapters = [HEAD, table, _settings()]
    for name, chapter in (
        ("udp", _udp),
        ("signed", _signed),
        ("http", _http),
        ("peers", _peers),
        ("window", _window),
        ("start", _start),
        ("install", _install),
    ):
        if name in parts:
            chapters.append(chapter(parts))
    if "floors" in parts:
        chapters.insert(3, _floors(parts))
    if "bare" in parts:
        chapters.insert(3, _bare(parts))
    chapters.append(_conditions(parts))
    if "udp" in parts:
        _draw_overload(parts["udp"]["overload"], folder)
    if "window" in parts:
        _draw_window(parts["window"]["points"], folder)
    (folder / PAGE_NAME).write_text(filled("\n".join(chapters)), encoding="utf-8")
    return table


def filled(page: str) -> str:
    """Return a page with the lines of its paragraphs as long as the other pages' are; tables and lists stay."""
    blocks = [
        block if block.lstrip().startswith(("|", "#", "!", "- ")) else textwrap.fill(block, LINE_CHARS)
        for block in page.strip().split("\n\n")
    ]
    return "\n\n".join(blocks) + "\n"


def targets_table(results: Mapping[str, Any]) -> str:
    """Return targets beside figures; what was missed says why, what was not measured says so.

    Args:
        results: What `bench.json` holds.
    """
    rows: list[dict[str, str | float]] = []
    for target in TARGETS:
        limit = _limit(target, results["parts"])
        word = "at least" if target.at_least else "at most"
        figure = results.get(target.key)
        if figure is None:
            shown, verdict = "", "not measured" if _was_asked(target, results["parts"]) is None else "**missed**: never"
        else:
            shown = target.written(figure)
            met = figure >= limit if target.at_least else figure <= limit
            verdict = "met" if met else f"**missed**: {MISSES.get(target.key, 'nobody has written down why')}"
        rows.append(
            {"what": target.meaning, "measured": shown, "target": f"{word} {target.written(limit)}", "": verdict}
        )
    return table_of(rows, number_format="")


def _limit(target: Target, parts: Mapping[str, Any]) -> float:
    return ready_limit_s(parts) if target.key == "ready_s" and "start" in parts else target.limit


def _was_asked(target: Target, parts: Mapping[str, Any]) -> bool | None:
    """Return true if the part that looks for a figure ran and found none; None if it did not run."""
    return True if target.key == "recovery_s" and "udp" in parts else None


def _settings() -> str:
    return (
        "Nothing in the unit's settings is chosen for these measurements but addresses, the database's place, the "
        "sections, and for signed passages keys, `udp.signatures` and `ingest.passages_per_certificate_count`, since "
        "few vehicles stand for many. All other limits, log and window are the defaults. Frames from this machine's "
        "own addresses do not count for `frames.frames_per_source_per_s`.\n"
    )


def _bare(parts: Mapping[str, Any]) -> str:
    bare = parts["bare"]
    rate = 1e6 / bare["bare_us"]
    return f"""## Beside the barest server

The speed of a rented machine changes by the second: within these measurements the same passage cost the unit
{bare["unit_at_its_best_us"]:.0f} µs in its best turn and {bare["unit_us"]:.0f} in the median. So the unit is measured
in turns with a server that takes the same datagrams over uvloop, asks both models for groups of up to 128, keeps the
bytes in SQLite with `synchronous=FULL` and answers, and does nothing else: no parsing, no checks, no memory, no window,
no advice (`bench/appliance/floor_servers.py`). It takes {rate:,.0f} passages a second and core
({bare["bare_us"]:.0f} µs each, {bare["bare_at_its_best_us"]:.0f} in its best turn); on the machine that the targets
were set on it took {REFERENCE_BARE_PER_S:,.0f}. A passage costs the unit **{bare["times_bare"]:.1f} times**
as much as it costs that server, the median of {len(bare["turns_us"])} turns. At the speed of that other
machine this ratio means
{REFERENCE_BARE_PER_S / bare["times_bare"]:,.0f} passages a second and core.

At a steady {bare["paced"]["rate_per_s"]:,.0f} a second, again in {len(bare["paced"]["turns"])} turns, batches are
small and every caller comes to cold caches: a passage costs the unit {bare["paced"]["unit_us"]:.0f} µs and the barest
server {bare["paced"]["bare_us"]:.0f}. From the frame to the answer the unit takes
{_ms(bare["paced"]["unit_latency_q50_ms"])} in the median and 99 % within
{_ms(bare["paced"]["unit_latency_q99_ms"])}, the barest server
{_ms(bare["paced"]["bare_latency_q50_ms"])} and {_ms(bare["paced"]["bare_latency_q99_ms"])}: what of the 99 % is the
machine's and what is the unit's.
"""


def _floors(parts: Mapping[str, Any]) -> str:
    floor = parts["floors"]
    both_models_us = sum(floor[name] for name in _MODELS)
    rows: list[dict[str, str | float]] = []
    for name, measured_us, floor_us, buys in (
        (
            "passage over UDP",
            parts.get("udp", {}).get("cpu_us_per_passage"),
            floor["datagram_us"] + both_models_us + floor["commit_row_us"],
            _PASSAGE_BUYS,
        ),
        (
            "passage over HTTP, frames",
            parts.get("http", {}).get("frames", {}).get("cpu_us_per_request"),
            floor["request_us"] + both_models_us + floor["commit_row_us"],
            "the same, and body limits, media types and error bodies of HTTP",
        ),
        (
            "passage over HTTP, JSON",
            parts.get("http", {}).get("json", {}).get("cpu_us_per_request"),
            floor["request_us"] + both_models_us + floor["commit_row_us"],
            "the same, and 115 numbers read from text, each with its own error message",
        ),
        (
            "read",
            parts.get("http", {}).get("reads", {}).get("cpu_us_per_request"),
            floor["request_us"],
            "advice that is right at the moment of the answer, ETags, metrics",
        ),
    ):
        if measured_us:
            rows.append(
                {
                    "one": name,
                    "measured, µs": f"{measured_us:.0f}",
                    "floor, µs": f"{floor_us:.0f}",
                    "times": f"{measured_us / floor_us:.1f}",
                    "what the difference buys": buys,
                }
            )
    table = table_of(rows, number_format="") if rows else ""
    return f"""## How far from the floor

The floor is what the parts cost in bare form, in processor time of one core: a datagram sent back over uvloop
{floor["datagram_us"]:.1f} µs; a request answered by an empty ASGI application under uvicorn {floor["request_us"]:.0f}
µs; the friction
model {floor["friction_model_1_rows_us"]:.1f} µs for a row alone and {floor["friction_model_64_rows_us"]:.1f} µs for
one of 64 together, the model of its
error {floor["error_model_1_rows_us"]:.1f} and {floor["error_model_64_rows_us"]:.1f} µs; a row of a passage's size
committed in SQLite, 100 at a time,
`synchronous=FULL`, {floor["commit_row_us"]:.1f} µs. The floor of a passage takes the models at 64 rows.

{table}"""


def _udp(parts: Mapping[str, Any]) -> str:
    udp, paced, over = parts["udp"], parts["udp"]["paced"], parts["udp"]["overload"]
    counted, after = over["server_counted"], over["after"]
    limit_ms, usual_ms = 1e3 * LATENCY_LIMIT_S, after["usual_ms"]
    in_order = " ".join(
        f"All accepted and 99 % of each {BIN_S:.2f} s {how}: "
        + ("not within this measurement." if since_s is None else f"from {since_s:.2f} s on.")
        for how, since_s in (
            (f"as soon as before the overload ({usual_ms:.0f} ms) or in {limit_ms:.0f} ms", after["recovered_after_s"]),
            (f"in {limit_ms:.0f} ms", after["in_time_after_s"]),
        )
    )
    return f"""## UDP

{udp["outstanding_count"]} passages without a receipt at any time, from {udp["sources_count"]} addresses, frames of
{udp["frame_bytes"]} bytes:
**{udp["passages_per_s_per_core"]:,.0f} passages a second and core**, {udp["passages_per_s"]:,.0f} a second by the
clock. Of {udp["sent_count"]:,}
passages {udp["accepted_count"]:,} were accepted, {udp["rejected_count"]:,} refused, {udp["unanswered_count"]:,} not
answered. The load took
{udp["loading_core_busy_frac"]:.0%} of its core.

At {PACE_PER_S:,.0f} a second, whatever the unit does, from sending the last frame to the receipt: median
{_ms(paced["latency_q50_ms"])}, 99 % within {_ms(paced["latency_q99_ms"])}, the slowest
{_ms(paced["latency_max_ms"])}; {paced["accepted_count"]:,} of {paced["sent_count"]:,}
accepted.

### Ten times too much

For {over["duration_s"]:.1f} s {over["offered_per_s"]:,.0f} passages a second were sent, {over["offered_times"]:.1f}
times what the unit takes (asked: {OVERLOAD_TIMES:.0f} times; a slower sender shows here). It went on taking
{over["accepted_per_s"]:,.0f} a second. Of the {over["sent_count"] + after["sent_count"]:,} frames of flood and
recovery the kernel dropped {over["kernel_dropped_count"]:,} at the unit's socket, and the unit's metrics count
{counted["frames_received_count"]:,}: {counted["accepted_count"]:,} accepted, {counted["refused_busy_count"]:,} refused
as busy, {counted["refused_otherwise_count"]:,} refused for other reasons, {counted["frames_dropped_count"]:,} dropped
with a reason. Not accounted for: {over["unaccounted_count"]:,}. Its memory went from
{over["resident_before_mb"]:.0f} to {over["resident_after_mb"]:.0f} MB.

Directly afterwards, at {PACE_PER_S:,.0f} a second: {after["accepted_count"]:,} of {after["sent_count"]:,} accepted.
{in_order}

![After the overload]({OVERLOAD_PICTURE}.svg)
"""


def _signed(parts: Mapping[str, Any]) -> str:
    signed, strangers = parts["signed"], parts["signed"]["certificate_never_seen"]
    return f"""## Signed

With `udp.signatures = "required"` and a unit that signs its receipts, frames of {signed["frame_bytes"]} bytes from
{signed["certificates_count"]:,} vehicles: **{signed["passages_per_s_per_core"]:,.0f} passages a second and core**
when the vehicle's certificate was met before, as after
its ARRIVAL ({signed["accepted_count"]:,} of {signed["sent_count"]:,} accepted);
{strangers["passages_per_s_per_core"]:,.0f} when every certificate is new and costs a second
verification ({strangers["accepted_count"]:,} of {strangers["sent_count"]:,} accepted).
"""


def _http(parts: Mapping[str, Any]) -> str:
    http = parts["http"]
    rows = [
        _request_row(name, http[key])
        for key, name in (
            ("frames", "passage, frames"),
            ("json", "passage, JSON"),
            ("advisory", "`/advisory`"),
            ("map", "`/map`"),
            ("reads", "both in turn"),
        )
    ]
    return f"""## HTTP

{http["connections_count"]} connections that stay open, each with one request under way.

{table_of(rows, number_format="")}"""


def _request_row(name: str, figures: Mapping[str, Any]) -> dict[str, str | float]:
    return {
        "request": name,
        "a second and core": f"{figures['requests_per_s_per_core']:,.0f}",
        "a second": f"{figures['requests_per_s']:,.0f}",
        "median": _ms(figures["latency_q50_ms"]),
        "99 %": _ms(figures["latency_q99_ms"]),
        "refused": f"{figures['bad_count']:,}",
        "bytes sent": f"{figures['request_bytes']:,}",
        "load's core": f"{figures['loading_core_busy_frac']:.0%}",
    }


def _peers(parts: Mapping[str, Any]) -> str:
    compared, ours = parts["peers"], parts["peers"]["ours"]
    names = {
        "udp": "roadgrip, UDP (another transport)",
        "http": "roadgrip, HTTP, frames",
        "http_json": "roadgrip, HTTP, JSON",
    }
    measured = [(peer, compared["peers"][peer.key]) for peer in PEERS if peer.key in compared["peers"]]
    known = [(peer, figures) for peer, figures in measured if "requests_per_s_per_core" in figures]
    rows: list[dict[str, str | float]] = [
        {
            "server": name,
            "a second and core": f"{ours['per_s_per_core'][way]:,.0f}",
            **{f"times {peer.name}": f"{compared['times'][way][peer.key]:.1f}" for peer, _ in known},
            "memory, MB": f"{ours['resident_mb']:.0f}",
        }
        for way, name in names.items()
    ]
    rows += [
        {
            "server": peer.name,
            "a second and core": f"{figures['requests_per_s_per_core']:,.0f}",
            **{f"times {other.name}": "" for other, _ in known},
            "memory, MB": f"{figures['resident_mb']:.0f}",
        }
        for peer, figures in known
    ]
    notes = []
    for peer, figures in measured:
        if "not_measured" in figures:
            notes.append(f"- **{peer.name}** was not measured: {figures['not_measured']}")
            continue
        versions = ", ".join(f"{name} {number}" for name, number in sorted(figures["versions"].items()))
        notes.append(f"- **{peer.name}** ({versions}): {figures['setting']}. {figures['bad_count']:,} bad answers.")
    return f"""## Others with the same model

In the same run, the packaged friction model behind servers that only infer: they check nothing, store nothing and ask
no second model. Same core, same connections, one row of the same width to a request, processor time of all their
processes; each answered the golden row right before it was measured. All run at once and are asked in
{len(compared["turns_us"])} turns; the factors are medians of the turns. Over UDP the unit uses another transport; HTTP
against HTTP is the fair line. The targets take its frames, which is what a vehicle sends; with
JSON on both sides the factor is that of the third line.

{table_of(rows, number_format="")}
{chr(10).join(notes)}
"""


def _window(parts: Mapping[str, Any]) -> str:
    window, restart = parts["window"], parts["window"]["restart_with_full_window"]
    held = window["points"][-1]["window_count"]
    return f"""## A full window

After {window["passages_count"]:,} passages, {held:,.0f} of which the windows hold (20,000 a section at most), the
process has
{window["rss_mb"]:.0f} MB resident, {window["rss_at_start_mb"]:.0f} MB when it started; the database has
{window["database_mb"]:.0f} MB. Doing nothing for
{window["idle_s"]:.0f} s it takes {window["idle_cpu_frac"]:.2%} of a core. Started again it is ready after
{restart["ready_s"]:.1f} s with the newest {restart["window_at_ready_count"]:,.0f} vehicles in its windows; after
{restart["whole_s"]:.1f} s they are whole.

A passage costs {window["cost_last_to_first_quarter_ratio"]:.2f} times as much in the last quarter of the filling as
in the first.

![Cost and memory against the window's size]({WINDOW_PICTURE}.svg)
"""


def _start(parts: Mapping[str, Any]) -> str:
    start = parts["start"]
    bill = list(start["memory_mb"].items())
    rows: list[dict[str, str | float]] = [
        {"of the memory": name, "MB": f"{size_mb:.1f}"} for name, size_mb in bill[:LARGEST_PACKAGES_COUNT]
    ]
    rest_mb = sum(size_mb for _, size_mb in bill[LARGEST_PACKAGES_COUNT:])
    rows.append({"of the memory": f"{len(bill) - len(rows)} more", "MB": f"{rest_mb:.1f}"})
    return f"""## Start

From starting the process to the first answer that it is ready: {start["ready_s"]:.2f} s (median of several starts in
turn with the
imports); {start["first_start_ready_s"]:.2f} s the first time, when it makes its database. Python alone imports the
same {start["modules_count"]:,}
modules in {start["import_s"]:.2f} s. The target is the larger of 2 s and the imports with {IMPORT_MORE_S} s more.

What these modules and the models take of the memory, {sum(start["memory_mb"].values()):.0f} MB together:

{table_of(rows, number_format="")}"""


def _install(parts: Mapping[str, Any]) -> str:
    install = parts["install"]
    packages = list(install["packages_mb"].items())
    rest_mb = sum(size_mb for _, size_mb in packages[LARGEST_PACKAGES_COUNT:])
    rows: list[dict[str, str | float]] = [
        {"package": name, "MB": f"{size_mb:.1f}"} for name, size_mb in packages[:LARGEST_PACKAGES_COUNT]
    ]
    rows.append({"package": f"{len(packages) - len(rows)} more", "MB": f"{rest_mb:.1f}"})
    return f"""## Installed

The locked runtime (`requirements/rsu.txt`) and roadgrip's wheel in a new environment: {install["install_mb"]:.0f} MB,
{install["bytecode_mb"]:.0f} MB of it
compiled bytecode. Python itself comes with the system.

{table_of(rows, number_format="")}"""


def _conditions(parts: Mapping[str, Any]) -> str:
    all_here = {name: figures["conditions"] for name, figures in parts.items()}
    rows: list[dict[str, str | float]] = [
        {
            "part": name,
            "at": here["at"],
            "commit": here["commit"],
            "took": f"{here['took_s']:.0f} s",
            "busy before": f"{here['busy_frac']:.0%}",
            "load average": f"{here['load_average']:.2f}",
            "fsync, median and 99 %": f"{_ms(here['fsync_q50_ms'])}, {_ms(here['fsync_q99_ms'])}",
        }
        for name, here in all_here.items()
    ]
    machines = dict.fromkeys(map(_machine, all_here.values()))
    runs_count = len({figures["run"] for figures in parts.values()})
    one_run = "All parts come from one run." if runs_count == 1 else f"The parts come from {runs_count} runs."
    return f"""## Conditions

{"; or ".join(machines)}.

{one_run} "Busy before" is what others used of all cores just before a part began; where that is not near zero the
figures are worth less. Of a frame on the loopback the sender pays for the way in and the unit for the way out.

{table_of(rows, number_format="")}"""


def _machine(here: Mapping[str, Any]) -> str:
    libraries = ", ".join(f"{name} {number}" for name, number in here["libraries"].items())
    cores = f"{here['cores_count']} cores (unit on {here['measured_core']}, load on {here['loading_core']})"
    return f"{here['processor']}, {cores}, {here['system']}, Python {here['python']}; {libraries}"


def _ms(figure_ms: float | None) -> str:
    return "never" if figure_ms is None else f"{figure_ms:.1f} ms"


def _draw_window(points: list[Mapping[str, float]], folder: Path) -> None:
    figure, (cost, memory) = panels(1, 2, title="The unit while its windows fill")
    held = np.array([point["window_count"] for point in points])
    for axes, key, title, unit in (
        (cost, "cpu_us_per_passage", "A passage's processor time", "µs"),
        (memory, "resident_mb", "Resident memory", "MB"),
    ):
        label(axes, title, x="vehicles in the windows", y=unit)
        line(axes, held, np.array([point[key] for point in points]), OURS, marker="o", markersize=3)
        axes.set_ylim(bottom=0.0)
    write(figure, folder, WINDOW_PICTURE)


def _draw_overload(over: Mapping[str, Any], folder: Path) -> None:
    rows = [row for row in over["timeline"] if row["latency_q99_ms"] is not None]
    figure, (accepted, latency) = panels(1, 2, title="After ten times too much, at 1,000 passages a second")
    at_s = np.array([row["from_s"] for row in over["timeline"]])
    label(accepted, "Accepted", x="s after the overload", y="share of passages")
    line(accepted, at_s, np.array([row["accepted_frac"] for row in over["timeline"]]), OURS)
    accepted.set_ylim(-0.05, 1.05)
    label(latency, "Receipt within, 99 %", x="s after the overload", y="ms")
    line(latency, np.array([row["from_s"] for row in rows]), np.array([row["latency_q99_ms"] for row in rows]), OURS)
    latency.axhline(1e3 * LATENCY_LIMIT_S, color=THEORY, linewidth=1.0)
    latency.set_yscale("log")
    write(figure, folder, OVERLOAD_PICTURE)
