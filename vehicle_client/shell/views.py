"""How a fleet looks: a progress bar while it drives, a table or JSON when it is done."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any, Self

from roadgrip.records import VEHICLE_FRAME_BUDGET, Accepted, Advisory
from roadgrip.units import mps_to_kph
from vehicle_client.shell.fleet_events import FleetReady, PassageEnded, VehicleEntered

if TYPE_CHECKING:
    from types import TracebackType

    from rich.console import Console
    from rich.table import Table

    from vehicle_client.shell.fleet_events import FleetEvent, FleetReport


class FleetProgress:
    """A progress bar that a fleet's events move; a context manager."""

    def __init__(self, console: Console, *, vehicles_count: int) -> None:
        """Prepare a bar for so many vehicles; on a console that is no terminal nothing is drawn."""
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            SpinnerColumn,
            TextColumn,
            TimeElapsedColumn,
        )

        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[detail]}"),
            TimeElapsedColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._vehicles_count = vehicles_count
        self._task = self._progress.add_task(
            "preparing the simulator (the first time takes a minute)", detail="", total=None
        )
        self._accepted_count = 0

    def __enter__(self) -> Self:
        """Draw."""
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop drawing; the last state stays."""
        self._progress.stop()

    def watch(self, event: FleetEvent) -> None:
        """Show what an event changes."""
        if isinstance(event, FleetReady):
            self._progress.update(self._task, description="vehicles", total=self._vehicles_count, completed=0)
        elif isinstance(event, VehicleEntered):
            self._progress.update(self._task, detail=f"road {event.base_friction_mu:.2f}")
        elif isinstance(event, PassageEnded):
            self._accepted_count += isinstance(event.record.outcome, Accepted)
            self._progress.update(
                self._task,
                advance=0 if event.from_spool else 1,
                detail=f"road {event.base_friction_mu:.2f}, {self._accepted_count} acknowledged",
            )


def advice_text(advisory: Advisory | None) -> str:
    """Return an advisory as a person reads it."""
    if advisory is None:
        return "no advice"
    text = f"{mps_to_kph(advisory.speed_mps):.0f} km/h ({advisory.reason.value.replace('_', ' ')})"
    interval = advisory.interval
    if interval is not None:
        text += (
            f", friction {interval.mu_low:.2f} to {interval.mu_new:.2f} from {interval.passages_count} vehicles,"
            f" {interval.confidence.value}"
        )
    return text


def fleet_report_to_json(report: FleetReport) -> dict[str, Any]:
    """Return the account as JSON shows it."""
    # Not `asdict` for the whole: it takes counters apart.
    shown = {field.name: getattr(report, field.name) for field in fields(report)}
    shown["air"] = asdict(report.air)
    shown["passage_ids"] = [passage_id.hex() for passage_id in report.passage_ids]
    shown["simulated_s"] = round(report.simulated_s, 1)
    return shown


def fleet_report_table(report: FleetReport) -> Table:
    """Return the account as a table for a person."""
    from rich.table import Table

    table = Table("what", "count", "detail", title="The fleet's account", title_justify="left")
    table.add_row("vehicles", str(report.vehicles_count), _listed(report.drives))
    table.add_row("acknowledged", str(report.accepted_count), f"{report.counted_count} of them counted in the window")
    for name, counts in (
        ("not counted", report.not_counted),
        ("refused by the unit", report.rejected),
        ("kept by the vehicle", report.withheld),
    ):
        if counts:
            table.add_row(name, str(counts.total()), _listed(counts))
    if report.no_map_count:
        hint = "" if report.accepted_count else "does a unit run there, and does it serve this section?"
        table.add_row("never got the map", str(report.no_map_count), hint)
    if report.spooled_count:
        table.add_row(
            "had to wait in the spool",
            str(report.spooled_count),
            f"{report.delivered_late_count} delivered late, {report.waiting_count} still waiting, "
            f"{report.frames_spent_count + report.spool_dropped_count} given up",
        )
    air = report.air
    table.add_row(
        "frames", str(air.offered_count), f"{report.frames_sent_count} sent by vehicles, {report.retries_count} retries"
    )
    table.add_row(
        "spoiled by the air",
        str(air.missing_count + air.doubled_count + air.delayed_count),
        f"{air.lost_count} lost, {air.spoiled_count} damaged, {air.doubled_count} doubled, {air.delayed_count} late",
    )
    table.add_row("lost but recovered", str(report.recovered_count), "their passages were acknowledged all the same")
    table.add_row(
        "most frames of one vehicle", str(report.budget_peak_count), f"the rules allow {VEHICLE_FRAME_BUDGET}"
    )
    return table


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())
