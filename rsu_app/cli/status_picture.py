"""The status of a unit as lines on a terminal: the whole of it in 80 columns, in 24 rows if it must be.

Plain letters only and nothing that is told by colour alone: it is read over serial lines, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from rich.text import Text

from roadgrip.units import mps_to_kph
from rsu_app.words import duration_words, size_words

WIDTH_COUNT = 80
WIDE_COUNT = 110
LABEL_COUNT = 9
SECTION_COUNT = 16
MORE = "..."
_WHY = {
    "friction_interval": "friction interval",
    "lower_confidence_bound": "lower bound",
    "winter_speed_while_provisional": "winter: provisional",
    "winter_speed_few_vehicles": "winter: few vehicles",
    "winter_speed_stale_window": "winter: stale window",
    "winter_speed_no_model": "winter: no model",
}
_OUTCOMES = ("counted", "uncounted", "repeated", "rejected")


def picture(said: Mapping[str, Any], *, width_count: int, height_count: int | None) -> list[Text]:
    """Return the status as lines.

    Args:
        said: What the unit answers at `/status`.
        width_count: Columns; longer lines are cut.
        height_count: Rows; None for as many as it takes. What there is much of (sections, refusals, drift) is cut to
            them, and says that it was.
    """
    blocks = [
        [_head(said)],
        _needs(said["conditions"]),
        _sections(said["sections"], width_count=width_count),
        _drift(said["sections"]),
        _model(said["model"]),
        _clock(said["clock"]),
        _disk(said["disk"]),
        _traffic(said),
        _refused(said["traffic"]["refusals"]),
    ]
    if height_count is not None:
        _fit(blocks, cut=(8, 3, 2), height_count=height_count)
    lines = [line for block in blocks for line in block]
    for line in lines:
        if len(line) > width_count:
            line.truncate(width_count - len(MORE))
            line.append(MORE)
    return lines


def _head(said: Mapping[str, Any]) -> Text:
    process = said["process"]
    ready = said["ready"]
    text = Text(f"roadgrip {said['version']}  ")
    text.append("READY" if ready else "NOT READY", style="bold green" if ready else "bold red")
    limit_bytes = process["memory_limit_bytes"]
    limit = "" if limit_bytes is None else f" of {size_words(limit_bytes)}"
    text.append(
        f"  {said['at'].replace('T', ' ').replace('+00:00', 'Z')}  up {duration_words(process['up_s'])}"
        f"  {size_words(process['resident_bytes'])}{limit}"
    )
    return text


def _sections(sections: Iterable[Mapping[str, Any]], *, width_count: int) -> list[Text]:
    wide = width_count >= WIDE_COUNT
    name_count = SECTION_COUNT + (min(32, width_count - WIDE_COUNT) if wide else 0)
    newest = f"  {'newest':>12}" if wide else ""
    head = f"{'section':<{name_count}}  cars  {'interval':<9}  {'confidence':<12}  {'advice':>8}{newest}  why"
    lines = [Text(head, style="bold underline")]
    for each in sections:
        interval = "-"
        if each["mu_new"] is not None:
            interval = f">= {each['mu_low']:.2f}" if each["at_least"] else f"{each['mu_low']:.2f}-{each['mu_new']:.2f}"
        advised = "-" if each["advised_mps"] is None else f"{mps_to_kph(each['advised_mps']):.0f} km/h"
        age = "-" if each["newest_age_s"] is None else f"{duration_words(each['newest_age_s'])} ago"
        line = Text(f"{_shortened(each['section_id'], name_count):<{name_count}}  {each['passages_count']:>4}  ")
        line.append(f"{interval:<9}", style="cyan")
        line.append(f"  {each['confidence'] or '-':<12}  ")
        line.append(f"{advised:>8}", style="bold")
        line.append(f"  {age:>12}" if wide else "")
        line.append(f"  {_WHY.get(str(each['advice_reason']), each['advice_reason'])}")
        lines.append(line)
    return lines


def _drift(sections: Iterable[Mapping[str, Any]]) -> list[Text]:
    told = []
    for each in sections:
        if (drift := each["drift"]) is None:
            continue
        alarms = ", ".join(drift["alarms"])
        moved = ", ".join(feature["feature"] for feature in drift["worst"])
        line = Text(f"{each['section_id']}: ")
        line.append(alarms or "no alarm", style="bold yellow" if alarms else "")
        line.append(
            f"; {drift['own_drifted_count']} features moved, {drift['out_of_envelope_frac']:.1%} outside the envelope"
            + (f"; most: {moved}" if moved else "")
        )
        told.append(line)
    return _labelled("drift", told)


def _model(model: Mapping[str, Any]) -> list[Text]:
    lines = [
        Text(
            ("none" if model["live_bundle_id"] is None else f"{model['live_bundle_id']}, {_release(model['live'])}")
            + f"; {model['stage']}, ring {model['ring']}",
            style="" if model["live_bundle_id"] else "bold red",
        )
    ]
    if (candidate := model["candidate"]) is not None:
        lines.append(Text(f"shadow {candidate['bundle_id']}, {_release(candidate)}"))
    if (previous := model["previous"]) is not None:
        lines.append(Text(f"before {previous['bundle_id']}, {_release(previous)}"))
    if (found := model["comparison"]) is not None:
        apart = "" if found["median_ratio"] is None else f", in the median {found['median_ratio']:+.1%} apart"
        lines.append(Text(f"compared by {found['passages_count']} of {model['wanted_count']} passages{apart}"))
    if (refusal := model["last_refusal"]) is not None:
        lines.append(Text(f"release refused: {refusal['reason']}: {refusal['detail']}", style="yellow"))
    return _labelled("model", lines)


def _release(bundle: Mapping[str, Any]) -> str:
    return f"release {bundle['sequence_number']}, gate {bundle['gate']}" if bundle["sequence_number"] else "factory"


def _clock(clock: Mapping[str, Any]) -> list[Text]:
    steps = clock["steps"]
    kept = {True: "kept right", False: "kept right by nothing", None: "kept right: unknown"}[clock["synchronised"]]
    within = "" if clock["max_error_s"] is None else f" within {clock['max_error_s'] * 1000.0:.0f} ms"
    line = Text("wall clock plausible" if clock["ok"] else clock["detail"], style="" if clock["ok"] else "bold red")
    line.append(f", {kept}{within}", style="" if clock["synchronised"] else "yellow")
    if clock["speedup_ratio"] != 1.0:
        line.append(f"; RUNS AT {clock['speedup_ratio']:g} TIMES ITS PACE", style="bold red")
    last = (
        ""
        if steps["last_ago_s"] is None
        else (f", the last {duration_words(steps['last_ago_s'])} ago by {steps['last_step_s']:+.1f} s")
    )
    moved = f"{steps['steps_count']} steps{last}; moved by {steps['moved_s']:+.3f} s since the start"
    return _labelled("clock", [line, Text(moved)])


def _disk(disk: Mapping[str, Any]) -> list[Text]:
    room = (
        "free space unknown"
        if disk["free_bytes"] is None
        else f"{size_words(disk['free_bytes'])} free of {size_words(disk['size_bytes'])}"
    )
    count = "no answer" if disk["passages_count"] is None else f"{disk['passages_count']} passages"
    ago_s = disk["committed_ago_s"]
    committed = "no commit yet, or the last one failed" if ago_s is None else f"last commit {duration_words(ago_s)} ago"
    lines = [
        Text(f"{room}; database {size_words(disk['database_bytes'])}, log {size_words(disk['log_bytes'])}; {count}"),
        Text(f"{committed}; {disk['queued_count']} of {disk['queue_limit_count']} writes wait"),
    ]
    lines += [Text(note, style="yellow") for note in disk["notes"]]
    return _labelled("disk", lines)


def _traffic(said: Mapping[str, Any]) -> list[Text]:
    per_s, outcomes = said["traffic"]["per_s"], said["passages"]["outcomes"]
    names = [*_OUTCOMES, *sorted(set(outcomes) - set(_OUTCOMES))]
    lines = [
        Text(", ".join(f"{per_s.get(name, 0.0):.2f} {name}" for name in names) + " a second"),
        Text(", ".join(f"{outcomes.get(name, 0)} {name}" for name in names) + " since the start"),
    ]
    if dropped_count := said["log_lines_dropped_count"]:
        lines.append(Text(f"{dropped_count} log lines dropped", style="yellow"))
    return _labelled("traffic", lines)


def _refused(refusals: Iterable[Mapping[str, Any]]) -> list[Text]:
    return _labelled(
        "refused",
        [
            Text(
                f"{each['at'][11:19]}  {each['reason']}, {each['via']}"
                + (f", {each['section']}" if each["section"] else "")
                + (f", {each['refused_count']} times" if each["refused_count"] > 1 else "")
                + (f": {each['detail']}" if each["detail"] else "")
            )
            for each in refusals
        ],
    )


def _needs(conditions: Iterable[Mapping[str, Any]]) -> list[Text]:
    """Return what is wrong, a line each, and what is not, in one."""
    lines, sound = [], []
    for each in conditions:
        if each["ok"]:
            sound.append(each["name"])
            continue
        line = Text()
        line.append("NO   " if each["required"] else "note ", style="bold red" if each["required"] else "yellow")
        line.append(f"{each['name']}: {each['detail']}")
        lines.append(line)
    if sound:
        lines.append(Text.assemble(("ok   ", "green"), ", ".join(dict.fromkeys(sound))))
    return _labelled("needs", lines)


def _labelled(label: str, lines: list[Text]) -> list[Text]:
    return [Text.assemble((f"{'' if i else label:<{LABEL_COUNT}}", "bold"), line) for i, line in enumerate(lines)]


def _shortened(text: str, limit_count: int) -> str:
    return text if len(text) <= limit_count else text[: limit_count - len(MORE)] + MORE


def _fit(blocks: list[list[Text]], *, cut: tuple[int, ...], height_count: int) -> None:
    """Cut the longest of some blocks, line by line, until all of them fit or nothing is left to cut."""
    dropped_counts = dict.fromkeys(cut, 0)
    while sum(map(len, blocks)) > height_count:
        longest = max(cut, key=lambda number: len(blocks[number]))
        if len(blocks[longest]) <= 2:
            return
        # The last line says how many are missing, and is one of them the first time.
        gone_count = 1 if dropped_counts[longest] else 2
        del blocks[longest][-2:]
        dropped_counts[longest] += gone_count
        blocks[longest].append(Text(f"{'':<{LABEL_COUNT}}{MORE} {dropped_counts[longest]} more", style="dim"))
