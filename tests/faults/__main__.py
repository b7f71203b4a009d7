"""The fault matrix from the command line: `make faults`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from tests.faults.machine import can_be_made
from tests.faults.matrix import SCENARIOS, noticed, perform
from tests.faults.matrix_page import control_of, figures_of, keep, merged, page_with, read
from tests.faults.scenario import Scenario

ROOT = Path(__file__).resolve().parents[2]
RESULTS, PAGE = ROOT / "docs" / "results" / "faults.json", ROOT / "docs" / "faults.md"

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def main(
    scenarios: Annotated[
        list[str] | None, typer.Argument(help="Which scenarios; all of them if none is named.")
    ] = None,
    *,
    runs: Annotated[int, typer.Option(help="How often each fault happens; 0: as often as its table says.", min=0)] = 0,
    seed: Annotated[int, typer.Option(help="Where chance begins.")] = 1,
    controls: Annotated[
        bool, typer.Option("--controls", help="Break the unit on purpose instead; each scenario must notice.")
    ] = False,
    break_as: Annotated[str, typer.Option("--break", help="Break the unit in one way only, by its name.")] = "",
    out: Annotated[Path, typer.Option(help="Where the figures are kept; what is not performed stays.")] = RESULTS,
    page: Annotated[Path, typer.Option(help="The page whose tables are made from them.")] = PAGE,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures of what was performed.")] = False,
    names_only: Annotated[bool, typer.Option("--list", help="List the scenarios and what can be broken.")] = False,
) -> None:
    """Make faults happen to real units and look whether each promise is kept; exit code 1 if one is not."""
    if names_only:
        for scenario in SCENARIOS:
            typer.echo(f"{scenario.name} ({scenario.runs_count} runs): {', '.join(scenario.controls)}")
        return
    chosen = _chosen(scenarios or [])
    if not can_be_made():
        typer.echo("faults: gcc is needed, for the layer between a unit and its disk", err=True)
        raise typer.Exit(2)
    console = Console(stderr=True, soft_wrap=True)
    kept, failed = [], False
    for scenario in chosen:
        if controls or break_as:
            row = _with_controls(
                scenario, [break_as] if break_as else list(scenario.controls), seed=seed, console=console
            )
            failed |= not all(control["noticed"] for control in row["controls"])
        else:
            row = _performed(scenario, runs=runs or scenario.runs_count, seed=seed, console=console)
            failed |= not row["passed"]
        kept.append(row)
        # After each, since all of them take half an hour; read again, since others may keep theirs meanwhile.
        rows = merged(read(out), row, SCENARIOS)
        keep(out, rows)
        if page.exists():
            page.write_text(page_with(page.read_text(encoding="utf-8"), rows), encoding="utf-8")
    if as_json:
        typer.echo(json.dumps(kept, indent=1))
    raise typer.Exit(int(failed))


def _chosen(names: list[str]) -> list[Scenario]:
    known = {scenario.name: scenario for scenario in SCENARIOS}
    if unknown := [name for name in names if name not in known]:
        typer.echo(f"faults: no scenario {', '.join(unknown)}; there are {', '.join(known)}", err=True)
        raise typer.Exit(2)
    return [known[name] for name in names] or list(SCENARIOS)


def _performed(scenario: Scenario, *, runs: int, seed: int, console: Console) -> dict[str, Any]:
    columns = (TextColumn("{task.description:32}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(scenario.name, total=runs)
        performance = perform(
            scenario, seed=seed, runs_count=runs, tell=lambda count: progress.advance(task, float(count))
        )
    found = performance.finding
    verdict = "kept" if found.passed else "NOT KEPT"
    console.print(
        f"{scenario.name:32} {found.runs_count:4} runs  {found.acknowledged_count:6} acknowledged  "
        f"{found.lost_count} lost  {found.duplicated_count} twice  {verdict}  {performance.took_s:.0f} s"
    )
    for problem in found.problems[:10]:
        console.print(f"    {problem}", markup=False)
    return figures_of(performance)


def _with_controls(scenario: Scenario, names: list[str], *, seed: int, console: Console) -> dict[str, Any]:
    rows = []
    for name in names:
        with console.status(f"{scenario.name}: {name}"):
            performance = noticed(scenario, name, seed=seed)
        rows.append(control_of(performance, name))
        verdict = "noticed" if rows[-1]["noticed"] else "NOT NOTICED"
        console.print(f"{scenario.name:32} broken: {name}: {verdict}  {performance.took_s:.0f} s")
    return {"scenario": scenario.name, "controls": rows}


if __name__ == "__main__":
    app()
