"""How the demo looks in a terminal: a live view, or plain lines where nobody watches."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Protocol

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from deploy.demo.chart import CHART_ROWS, CONFIDENCE_STYLE, chart, clock_text, legend
from roadgrip.records import VEHICLE_FRAME_BUDGET
from vehicle_client.shell.views import advice_text

if TYPE_CHECKING:
    from deploy.demo.story import Check, Story

CHART_ROWS_LEAST = 6
ROWS_BESIDE_CHART = 18
LAST_COUNT = 6
PLAIN_EVERY_FRAC = 0.1


class View(Protocol):
    """Whatever shows a demo."""

    def step(self, text: str) -> contextlib.AbstractContextManager[None]:
        """Show that something takes a while, until the context ends."""
        ...

    def say(self, text: str) -> None:
        """Show a line that stays."""
        ...

    def watching(self, story: Story) -> contextlib.AbstractContextManager[None]:
        """Show the fleet until the context ends."""
        ...

    def refresh(self) -> None:
        """Show what is new in the story that is being watched."""
        ...


class PlainView:
    """Lines, for logs and for those who want to read them later."""

    def __init__(self, console: Console) -> None:
        """Write to a console."""
        self._console = console
        self._story: Story | None = None
        self._said_count = -1

    @contextlib.contextmanager
    def step(self, text: str) -> Iterator[None]:
        """Say what begins."""
        self.say(f"{text} ...")
        yield

    def say(self, text: str) -> None:
        """Write a line."""
        self._console.print(text, highlight=False, soft_wrap=True)

    @contextlib.contextmanager
    def watching(self, story: Story) -> Iterator[None]:
        """Write a line for every tenth of the fleet."""
        self._story = story
        yield
        self._story = None

    def refresh(self) -> None:
        """Write a line if another tenth of the fleet has come."""
        story = self._story
        if story is None or not story.started:
            return
        part = int(len(story.vehicles) / story.vehicles_count / PLAIN_EVERY_FRAC)
        if part > self._said_count:
            self._said_count = part
            self.say(story_line(story))


class LiveView:
    """A picture that changes in place."""

    def __init__(self, console: Console) -> None:
        """Draw on a console that is a terminal."""
        self._console = console
        self._live: Live | None = None
        self._story: Story | None = None

    @contextlib.contextmanager
    def step(self, text: str) -> Iterator[None]:
        """Spin until it is done."""
        with self._console.status(text):
            yield
        self.say(f"[green]✓[/] {text}")

    def say(self, text: str) -> None:
        """Write a line that stays."""
        self._console.print(text, highlight=False)

    @contextlib.contextmanager
    def watching(self, story: Story) -> Iterator[None]:
        """Draw, and leave the last state on the screen."""
        self._story = story
        with Live(self._picture(story), console=self._console, refresh_per_second=4) as live:
            self._live = live
            yield
            self.refresh()
        self._live = self._story = None

    def refresh(self) -> None:
        """Draw anew."""
        if self._live is not None and self._story is not None:
            self._live.update(self._picture(self._story))

    def _picture(self, story: Story) -> Group:
        rows_count = min(CHART_ROWS, max(CHART_ROWS_LEAST, self._console.height - ROWS_BESIDE_CHART))
        return picture_of(story, chart_rows_count=rows_count)


def story_line(story: Story) -> str:
    """Return the state of things in one line."""
    account = story.account
    now = story.readings[-1] if story.readings else None
    return (
        f"{len(story.vehicles):4d}/{story.vehicles_count} vehicles, road {story.base_friction_mu:.2f}, "
        f"{account.accepted_count} acknowledged, frames {account.air.missing_count} lost "
        f"({account.recovered_count} recovered); " + (advice_text(now.advisory) if now else "no advice yet")
    )


def picture_of(story: Story, *, chart_rows_count: int = CHART_ROWS) -> Group:
    """Return the whole live view."""
    grid = Table.grid(expand=True, padding=(0, 2))
    grid.add_column(ratio=1)
    grid.add_column(ratio=1)
    grid.add_row(_traffic(story), _estimates(story))
    bar = Table.grid(padding=(0, 2))
    bar.add_row(
        ProgressBar(total=story.vehicles_count, completed=len(story.vehicles), width=48),
        f"{len(story.vehicles)}/{story.vehicles_count} vehicles",
        clock_text(story.readings[-1].at_s)
        if story.readings
        else "the simulator compiles; the first time takes a minute",
    )
    return Group(
        bar,
        Panel(
            Group(chart(story, rows_count=chart_rows_count), legend()),
            title="friction: what the unit publishes against the truth",
        ),
        Panel(_advice(story), title="what drivers are told"),
        grid,
    )


def _advice(story: Story) -> Text:
    if not story.readings:
        return Text("nothing yet")
    advisory = story.readings[-1].advisory
    return Text(advice_text(advisory), style=CONFIDENCE_STYLE[advisory.confidence])


def _traffic(story: Story) -> Table:
    account, air = story.account, story.account.air
    table = Table.grid(padding=(0, 1))
    for name, value in (
        ("road now (new tyre)", f"{story.base_friction_mu:.2f}"),
        ("on their way", f"{story.on_the_road_count}"),
        ("acknowledged", f"{account.accepted_count} ({account.counted_count} counted)"),
        ("slid off the road", f"{story.off_the_road_count}"),
        ("frames in the air", f"{air.offered_count}"),
        ("lost or damaged", f"{air.missing_count} ({account.recovered_count} recovered)"),
        ("doubled, late", f"{air.doubled_count}, {air.delayed_count}"),
        ("most frames of a vehicle", f"{account.budget_peak_count} of {VEHICLE_FRAME_BUDGET}"),
    ):
        table.add_row(name, value)
    return table


def _estimates(story: Story) -> Table:
    table = Table("vehicle", "its tyres found", "the unit estimated", "", box=None, padding=(0, 1))
    for vehicle, estimate in story.estimated()[-LAST_COUNT:]:
        table.add_row(
            str(vehicle.number + 1),
            f"{vehicle.friction_mu:.3f}",
            "-" if estimate.mu is None else f"{estimate.mu:.3f}",
            "" if estimate.counted else "not counted",
        )
    return table


def checks_table(checks: list[Check]) -> Table:
    """Return the promises and whether they were kept."""
    table = Table("promise", "kept", "figures", title="What the demo promised", title_justify="left")
    for check in checks:
        table.add_row(check.promise, "[green]yes[/]" if check.kept else "[bold red]NO[/]", check.detail)
    return table
