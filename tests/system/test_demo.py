"""`make demo` in a hurry, and the pieces that judge and draw it."""

from __future__ import annotations

import io
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("matplotlib")

from rich.console import Console

from deploy.demo.chart import ESTIMATE_MARK, INTERVAL_MARK, NOT_COUNTED_MARK, chart
from deploy.demo.picture import figure_of, write_page, write_picture
from deploy.demo.run import MARK, prepare_folder
from deploy.demo.story import Estimate, Story
from deploy.demo.terminal import picture_of, story_line
from deploy.demo.unit import DemoError
from roadgrip.records import (
    RSU_FRAME_BUDGET,
    VEHICLE_FRAME_BUDGET,
    Accepted,
    Advisory,
    AdvisoryReason,
    Confidence,
    FrictionInterval,
)
from vehicle_client.shell.exchange import Ending, ExchangeRecord
from vehicle_client.shell.fleet_events import FleetReady, PassageEnded, VehicleEntered
from vehicle_client.shell.uplink import AirCounts

ROOT = Path(__file__).parents[2]
FIRST_MU, SECOND_MU = 0.45, 0.25


def advice(mu_new: float | None, *, passages_count: int = 20) -> Advisory:
    interval = None
    if mu_new is not None:
        interval = FrictionInterval(
            mu_low=0.8 * mu_new,
            mu_new=mu_new,
            median_mu=0.9 * mu_new,
            median_low_mu=0.85 * mu_new,
            median_high_mu=0.95 * mu_new,
            coverage_frac=0.95,
            passages_count=passages_count,
            confidence=Confidence.PROVISIONAL,
            newest_age_s=10.0,
            valid_for_s=300.0,
        )
    return Advisory(13.89, AdvisoryReason.LOWER_CONFIDENCE_BOUND, Confidence.PROVISIONAL, interval, valid_for_s=300.0)


def ended(number: int, *, frames_count: int = 2, unit_frames_count: int = 3) -> PassageEnded:
    mu = FIRST_MU if number < 2 else SECOND_MU
    record = ExchangeRecord(
        passage_id=number.to_bytes(16, "big"),
        ending=Ending.ACCEPTED,
        outcome=Accepted(),
        withheld=None,
        advisory=None,
        map_version="0123456789abcdef",
        frames_sent_count=frames_count,
        frames_received_count=3,
        frames_refused_count=0,
        messages_ignored_count=0,
        arrival_tries_count=1,
        report_tries_count=1,
    )
    air = AirCounts(offered_count=frames_count + unit_frames_count)
    return PassageEnded(number, 1800.0 * number + 60.0, mu, 0.9 * mu, "completed", record, air)


def a_story(*, first_published: float | None = 0.46, last_published: float | None = 0.24) -> Story:
    """Four vehicles over two hours; the road changes half way."""
    story = Story(4, FIRST_MU, SECOND_MU)
    story.watch(FleetReady())
    for number in range(4):
        mu = FIRST_MU if number < 2 else SECOND_MU
        story.watch(VehicleEntered(number, 1800.0 * number, mu, 0.9 * mu))
        story.watch(ended(number))
        story.take_estimates([Estimate(number + 1, number.to_bytes(16, "big"), 0.9 * mu, counted=number != 3)])
        story.take_reading(1800.0 * number + 100.0, advice(first_published if number < 2 else last_published))
    return story


def broken(story: Story) -> list[str]:
    return [check.promise for check in story.checks() if not check.kept]


def test_a_story_that_went_well_keeps_its_promises():
    assert broken(a_story()) == []


@pytest.mark.parametrize(
    ("first", "last", "when"),
    [(0.60, 0.24, "before the road changes"), (0.46, 0.44, "at the end"), (None, 0.24, "before"), (0.46, None, "end")],
)
def test_an_interval_that_does_not_follow_the_road_breaks_a_promise(first: float | None, last: float | None, when: str):
    (promise,) = broken(a_story(first_published=first, last_published=last))
    assert "follows the road within 15%" in promise
    assert when in promise


def test_an_acknowledged_passage_that_is_not_stored_breaks_a_promise():
    story = a_story()
    del story.estimates[(2).to_bytes(16, "big")]
    assert broken(story) == ["every acknowledged passage is in the unit's database"]


def test_a_vehicle_that_never_came_breaks_a_promise():
    story = a_story()
    story.vehicles_count = 5
    assert broken(story) == ["every vehicle came"]


def test_a_vehicle_that_sent_too_much_breaks_a_promise():
    story = a_story()
    story.watch(ended(3, frames_count=VEHICLE_FRAME_BUDGET + 1))
    assert broken(story) == ["no vehicle sent more frames than it may"]


def test_a_unit_that_sent_a_vehicle_too_much_breaks_a_promise():
    story = a_story()
    story.watch(ended(3, unit_frames_count=RSU_FRAME_BUDGET - 2))
    assert broken(story) == ["the unit sent no vehicle more frames than it may"]


def test_the_chart_shows_estimates_where_they_are():
    rows = chart(a_story(), rows_count=13, columns_count=40).plain.splitlines()
    # Rows of 0.05 from the bottom: 0.405 lies in the ninth, 0.225 in the fifth.
    high, low = rows[12 - 8], rows[12 - 4]
    assert high.count(ESTIMATE_MARK) == 2
    assert (low.count(ESTIMATE_MARK), low.count(NOT_COUNTED_MARK)) == (1, 1)
    assert INTERVAL_MARK in high
    assert rows[-1].strip().startswith("0:00")


def test_an_empty_story_can_be_shown():
    story = Story(4, FIRST_MU, SECOND_MU)
    assert INTERVAL_MARK not in chart(story).plain
    assert "no advice yet" in story_line(story)
    console = Console(record=True, width=110, file=io.StringIO())
    console.print(picture_of(story))
    assert "0/4 vehicles" in console.export_text()


def test_the_picture_and_the_page_hold_the_story(tmp_path: Path):
    story = a_story()
    figure = figure_of(story, section_name="Bend", speed_limit_mps=20.0)
    write_picture(figure, tmp_path / "demo.png")
    checks = [replace(check, kept=False) for check in story.checks()]
    write_page(figure, story, checks, tmp_path / "demo.html", section_name="Bend <1>")
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "demo.html").read_text(encoding="utf-8")
    assert "Bend &lt;1&gt;" in page
    assert page.count("<td class=no>no</td>") == len(checks)
    assert "http://" not in page.replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
        "http://creativecommons.org", ""
    )


def test_a_folder_of_an_earlier_demo_is_emptied_and_no_other(tmp_path: Path):
    (tmp_path / MARK).touch()
    (tmp_path / "rsu.sqlite3").touch()
    prepare_folder(tmp_path)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(DemoError, match="not empty"):
        prepare_folder(tmp_path)
    assert (tmp_path / "thesis.tex").exists()


def run_demo(folder: Path, *options: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, ROOT / "deploy" / "demo" / "run.py", "--no-live", "--folder", folder, *options],
        capture_output=True,
        text=True,
        check=False,
        timeout=160,
        cwd=folder.parent,
    )


@pytest.mark.system
@pytest.mark.sim
def test_the_quick_demo_keeps_its_promises(tmp_path: Path):
    done = run_demo(tmp_path / "demo", "--quick")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "40/40 vehicles" in done.stdout
    left = {path.name for path in (tmp_path / "demo").iterdir()}
    assert left >= {"demo.png", "demo.html", "rsu.toml", "rsu.sqlite3", "rsu.log"}


@pytest.mark.system
def test_a_unit_that_cannot_start_ends_the_demo_with_one_line(tmp_path: Path):
    done = run_demo(tmp_path / "demo", "--bundle", tmp_path / "no-such-bundle")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("demo: the unit")
