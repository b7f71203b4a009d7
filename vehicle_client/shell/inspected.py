"""The findings about a recording, for a person and for a machine."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rich.table import Column, Table

from vehicle_client.recording.inspection import Verdict

if TYPE_CHECKING:
    from collections.abc import Iterable

    from vehicle_client.recording.inspection import Finding
    from vehicle_client.shell.recorded import RecordedDrive

_UNITS = {"mps2": "m/s²", "radps": "rad/s", "rad": "rad", "mps": "m/s"}
_COLOURS = {Verdict.OK: "green", Verdict.OFF: "red", Verdict.NOT_JUDGED: "yellow", Verdict.ABSENT: "dim"}


def something_is_off(findings: Iterable[Finding]) -> bool:
    """Return whether a channel must be read in another way."""
    return any(finding.verdict is Verdict.OFF for finding in findings)


def findings_table(findings: Iterable[Finding], drive: RecordedDrive) -> Table:
    """Return the findings as a table for a person."""
    trace = drive.recording.trace
    lasts_s = trace.samples_count / 100.0
    table = Table(
        Column("channel", no_wrap=True),
        *("per s", "range", "gap", "invalid"),
        Column("verdict", no_wrap=True),
        title=f"{lasts_s:.1f} s of driving, read as a {drive.vehicle.name}",
        title_justify="left",
        caption=_caption(drive),
        caption_justify="left",
    )
    for finding in findings:
        there = finding.verdict is not Verdict.ABSENT
        name, unit = _name_and_unit(finding.channel)
        table.add_row(
            name,
            _number(finding.rate_hz, "{:.0f}"),
            f"{finding.lower:.3g} to {finding.upper:.3g} {unit}" if math.isfinite(finding.lower) else "",
            _number(finding.longest_gap_s, "{:.2f} s"),
            f"{finding.invalid_frac:.1%}" if there else "",
            f"[{_COLOURS[finding.verdict]}]{finding.verdict.value}",
        )
    return table


def hints_of(findings: Iterable[Finding]) -> list[str]:
    """Return what there is to say about the channels, a line for each hint; channels with the same one share it."""
    by_hint: dict[tuple[Verdict, str], list[str]] = {}
    for finding in findings:
        for hint in filter(None, finding.hint.split("; ")):
            by_hint.setdefault((finding.verdict, hint), []).append(_name_and_unit(finding.channel)[0])
    return [f"{', '.join(names)} ({verdict.value}): {hint}" for (verdict, hint), names in by_hint.items()]


def findings_to_json(findings: Iterable[Finding], drive: RecordedDrive) -> dict[str, Any]:
    """Return the findings as JSON shows them."""
    findings = tuple(findings)
    trace = drive.recording.trace
    return {
        "ok": not something_is_off(findings),
        "vehicle": drive.vehicle.name,
        "samples_count": trace.samples_count,
        "valid_frac": float(trace.valid.mean()),
        "repeated_count": drive.recording.repeated_count,
        "channels": {
            finding.channel: {
                "verdict": finding.verdict.value,
                "hint": finding.hint,
                "rate_hz": _or_none(finding.rate_hz),
                "lower": _or_none(finding.lower),
                "upper": _or_none(finding.upper),
                "longest_gap_s": _or_none(finding.longest_gap_s),
                "invalid_frac": _or_none(finding.invalid_frac),
            }
            for finding in findings
        },
    }


def _name_and_unit(channel: str) -> tuple[str, str]:
    """Return what a channel is called in `signals.toml`, and its unit for a person."""
    name, _, suffix = channel.rpartition("_")
    return (name, _UNITS[suffix]) if suffix in _UNITS else (channel, "")


def _caption(drive: RecordedDrive) -> str:
    remarks = [f"{drive.recording.trace.valid.mean():.1%} of the samples are whole"]
    if drive.recording.repeated_count:
        remarks.append(f"{drive.recording.repeated_count} values gave way to a later one with the same time stamp")
    return "; ".join(remarks)


def _number(number: float, form: str) -> str:
    return form.format(number) if math.isfinite(number) else ""


def _or_none(number: float) -> float | None:
    return number if math.isfinite(number) else None
