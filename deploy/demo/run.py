"""`make demo`: the whole system does its job on this machine, while you watch.

A real road side unit is configured, migrated and started; simulated vehicles drive a curve at 100 an hour, in
accelerated time, over a radio that loses frames; half way the road turns slippery. You see vehicles, frames,
estimates, the published interval against the truth and the advised speed; a picture, a page and the unit's own
records are left in `build/demo`.
"""

from __future__ import annotations

import asyncio
import os
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from deploy.demo.story import Check, Story
from deploy.demo.terminal import LiveView, PlainView, View, checks_table
from deploy.demo.unit import DemoError, UnitFiles, UnitProcess, check_settings, migrate, write_config
from deploy.playing import run_play
from roadgrip.sections import read_section
from vehicle_client.shell.fleet import FleetPlan, FleetTools, FrictionChange, run_fleet, simulator
from vehicle_client.shell.keys import Keys
from vehicle_client.shell.uplink import AirFaults, parse_unit_address, uplinks_to
from vehicle_client.shell.views import fleet_report_table
from vehicle_client.simulator.plan import SensorGrade

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from vehicle_client.shell.fleet_events import FleetEvent

FOLDER = Path("build") / "demo"
MARK = "rsu.toml"
"""A folder that holds this file, or nothing, may be emptied for a new run."""
FIRST_MU, SECOND_MU = 0.45, 0.25
FAULTS = AirFaults(lost_frac=0.05, doubled_frac=0.02, delayed_frac=0.03, spoiled_frac=0.01)
ARRIVALS_PER_HOUR = 100.0
LOOK_WALL_S = 0.3
"""How often the unit is asked what it publishes."""


@dataclass(frozen=True, slots=True)
class Choices:
    """What a person may choose.

    Attributes:
        vehicles_count: How many come.
        arrivals_per_hour: How often.
        change_frac: After which share of them the road turns slippery.
        speedup_ratio: How fast the clocks of fleet and unit run.
        section: The road.
        seed: Of everything random.
        folder: Where everything is left.
        bundle: The model; None takes the packaged one.
    """

    vehicles_count: int = 240
    arrivals_per_hour: float = ARRIVALS_PER_HOUR
    change_frac: float = 0.5
    speedup_ratio: float = 100.0
    section: str = "s-turn"
    seed: int = 1
    folder: Path = FOLDER
    bundle: Path | None = None


FULL = Choices()
QUICK = Choices(vehicles_count=40, arrivals_per_hour=26.0, change_frac=0.3, speedup_ratio=250.0)
"""For a hurry and for tests: fewer vehicles, so the interval stays provisional, over the same hour and a half."""


def prepare_folder(folder: Path) -> None:
    """Make an empty folder, and throw away only what an earlier demo left there.

    Raises:
        DemoError: It holds something else.
    """
    if folder.exists() and any(folder.iterdir()):
        if not (folder / MARK).exists():
            raise DemoError(f"{folder} is not empty and was not made by a demo; choose another --folder")
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)


def plan_of(choices: Choices, section: RoadSection) -> FleetPlan:
    """Return the fleet that the choices ask for."""
    return FleetPlan(
        section=section,
        vehicles_count=choices.vehicles_count,
        base_friction_mu=FIRST_MU,
        changes=(FrictionChange(SECOND_MU, choices.change_frac),),
        arrivals_per_hour=choices.arrivals_per_hour,
        speedup_ratio=choices.speedup_ratio,
        grade=SensorGrade.AUTOMOTIVE,
        faults=FAULTS,
        seed=choices.seed,
    )


async def play(story: Story, plan: FleetPlan, unit: UnitProcess, view: View, *, udp_port: int, folder: Path) -> None:
    """Return when the fleet is through; the story then holds everything.

    Raises:
        DemoError: The unit's process ended.
    """
    import httpx

    from vehicle_client.pipeline import summarise_passage

    started_wall_s = time.monotonic()

    def watch(event: FleetEvent) -> None:
        nonlocal started_wall_s
        if not story.started:
            started_wall_s = time.monotonic()
        story.watch(event)

    async def look(client: httpx.AsyncClient) -> None:
        unit.check_alive()
        advisory = await unit.advisory(client)
        story.take_estimates(unit.new_estimates())
        if advisory is not None and story.started:
            story.take_reading((time.monotonic() - started_wall_s) * plan.speedup_ratio, advisory)
        view.refresh()

    async def keep_looking(client: httpx.AsyncClient) -> None:
        while True:
            await look(client)
            await asyncio.sleep(LOOK_WALL_S)

    async with (
        uplinks_to(parse_unit_address(f"udp://127.0.0.1:{udp_port}")) as open_uplink,
        httpx.AsyncClient() as client,
    ):
        tools = FleetTools(
            open_uplink=open_uplink,
            open_codec=Keys().codecs_for(plan.section.section_id, speedup_ratio=plan.speedup_ratio),
            simulate=simulator(),
            summarise=summarise_passage,
        )
        fleet = asyncio.create_task(run_fleet(plan, tools, spool_folder=folder / "spool", watch=watch))
        looking = asyncio.create_task(keep_looking(client))
        # Whichever ends first: the fleet with its account, or the look at a unit that is no more.
        await asyncio.wait({fleet, looking}, return_when=asyncio.FIRST_COMPLETED)
        for task in (fleet, looking):
            if not task.done():
                task.cancel()
        results = await asyncio.gather(fleet, looking, return_exceptions=True)
        for result in results:
            if isinstance(result, Exception):
                raise result
        await look(client)


def run_demo(choices: Choices, view: View, console: Console, *, keep_running: bool) -> bool:
    """Return whether the demo kept its promises.

    Raises:
        RoadgripError: It could not be played to its end.
    """
    section = read_section(choices.section)
    with view.step(f"preparing {choices.folder}"):
        prepare_folder(choices.folder)
        files, http_port, udp_port = write_config(
            choices.folder,
            section=_section_file(choices.section),
            speedup_ratio=choices.speedup_ratio,
            bundle=choices.bundle,
        )
        check_settings(files)
    with view.step("migrating the database"):
        migrate(files)
    unit = UnitProcess(files, section_id=section.section_id, http_port=http_port)
    try:
        with view.step(f"starting the road side unit: {unit.url} and udp://127.0.0.1:{udp_port}"):
            unit.wait_until_ready()
        plan = plan_of(choices, section)
        story = Story(choices.vehicles_count, FIRST_MU, SECOND_MU)
        hours = choices.vehicles_count / choices.arrivals_per_hour
        view.say(
            f"{choices.vehicles_count} vehicles on the {section.name}, {choices.arrivals_per_hour:.0f} an hour: "
            f"{hours:.1f} hours in {hours * 3600.0 / choices.speedup_ratio:.0f} s. "
            f"The road turns from {FIRST_MU:.2f} to {SECOND_MU:.2f} on the way."
        )
        with view.watching(story):
            asyncio.run(play(story, plan, unit, view, udp_port=udp_port, folder=choices.folder))
        checks = story.checks()
        if keep_running:
            _draw(story, checks, section, choices, view)
            _tell(files, choices.folder, view, url=unit.url)
            view.say("The unit keeps running; Ctrl-C stops it.")
            _wait_for_interrupt(unit)
        code = unit.stop()
        checks.append(Check("the unit ran to the end and stopped when asked", code == 0, f"exit code {code}"))
    finally:
        unit.stop()
    _draw(story, checks, section, choices, view)
    console.print(fleet_report_table(story.account))
    console.print(checks_table(checks))
    if not keep_running:
        _tell(files, choices.folder, view, url=None)
    return all(check.kept for check in checks)


def _section_file(text: str) -> str:
    """Return how the unit's settings, which lie in another folder, name the section."""
    return str(Path(text).resolve()) if Path(text).is_file() else text


def _draw(story: Story, checks: list[Check], section: RoadSection, choices: Choices, view: View) -> None:
    from deploy.demo.picture import figure_of, write_page, write_picture

    with view.step("drawing the picture"):
        figure = figure_of(story, section_name=section.name, speed_limit_mps=section.speed_limit_mps)
        write_picture(figure, choices.folder / "demo.png")
        write_page(figure, story, checks, choices.folder / "demo.html", section_name=section.name)


def _tell(files: UnitFiles, folder: Path, view: View, *, url: str | None) -> None:
    view.say("")
    view.say("Where to look next:")
    view.say(f"  the picture           {folder / 'demo.png'}, with all figures {folder / 'demo.html'}")
    if url is not None:
        view.say(f"  the unit              {url}, its HTTP interface {url}/docs, its metrics {url}/metrics")
    view.say(f"  its log               {files.log}")
    view.say(f"  its passages          {files.database} (SQLite)")
    view.say("  what you saw          docs/demo.md; how to serve a road of your own: deploy/README.md")
    if url is None:
        view.say("  the unit, still live  make demo ARGS=--keep-running")


def _wait_for_interrupt(unit: UnitProcess) -> None:
    try:
        while True:
            unit.check_alive()
            time.sleep(0.5)
    except KeyboardInterrupt:
        return


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def demo(  # noqa: PLR0917 - typer reads options by name
    vehicles: Annotated[int | None, typer.Option(min=4, help="How many vehicles come.")] = None,
    speedup: Annotated[float | None, typer.Option(min=1.0, max=1000.0, help="Hours per hour.")] = None,
    section: Annotated[str, typer.Option(help="A packaged section, or the path of a section file.")] = FULL.section,
    seed: Annotated[int, typer.Option(min=0, help="The same seed brings the same vehicles.")] = FULL.seed,
    quick: Annotated[bool, typer.Option("--quick", help="40 vehicles in half a minute.")] = False,  # noqa: FBT002
    live: Annotated[bool, typer.Option(help="Draw a live view; without a terminal there are lines.")] = True,  # noqa: FBT002
    keep_running: Annotated[bool, typer.Option("--keep-running", help="Leave the unit on until Ctrl-C.")] = False,  # noqa: FBT002
    folder: Annotated[Path, typer.Option(help="Where everything is left.")] = FOLDER,
    bundle: Annotated[Path | None, typer.Option(help="Another model bundle than the packaged one.")] = None,
) -> None:
    """Watch the whole system do its job: vehicles, frames, estimates, interval, advice."""
    chosen = QUICK if quick else FULL
    choices = Choices(
        vehicles_count=vehicles if vehicles is not None else chosen.vehicles_count,
        arrivals_per_hour=chosen.arrivals_per_hour,
        change_frac=chosen.change_frac,
        speedup_ratio=speedup if speedup is not None else chosen.speedup_ratio,
        section=section,
        seed=seed,
        folder=folder,
        bundle=bundle,
    )
    console = Console()
    view: View = LiveView(console) if live and console.is_terminal and "CI" not in os.environ else PlainView(console)
    kept = run_demo(choices, view, console, keep_running=keep_running)
    raise typer.Exit(0 if kept else 1)


def main() -> None:
    """Run the play."""
    run_play(app, name="demo")


if __name__ == "__main__":
    main()
