"""docs/live-client.md and the systemd unit say what the program does."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
import typer.main

import vehicle_client.cli
from tests.vehicle_client.shell.air import ADVICE
from vehicle_client.mapmatch.approach import TRIES_LIMIT_COUNT, Whereabouts
from vehicle_client.mapmatch.surroundings import LINES_LIMIT_COUNT, PASSES_LIMIT_COUNT
from vehicle_client.shell.live.cellular import SECTIONS_LIMIT_COUNT
from vehicle_client.shell.live.client import MAPS_LIMIT_COUNT
from vehicle_client.shell.live.dashboard import READERS_LIMIT_COUNT, SectionAhead, ShownAdvice, state_line
from vehicle_client.shell.spool import CAPACITY_COUNT

ROOT = Path(__file__).resolve().parents[4]
PAGE = (ROOT / "docs" / "live-client.md").read_text(encoding="utf-8")
SERVICE = (ROOT / "deploy" / "vehicle" / "roadgrip-vehicle.service").read_text(encoding="utf-8")
COMMAND: Any = typer.main.get_command(vehicle_client.cli.app_of())
OPTIONS = {name for parameter in COMMAND.commands["live"].params for name in parameter.opts if name.startswith("--")}


def test_every_option_has_its_row_and_every_row_its_option():
    rows = set(re.findall(r"^\| `(--[a-z-]+)` \|", PAGE, flags=re.MULTILINE))
    assert rows == OPTIONS - {"--help"}


def test_the_systemd_unit_uses_options_that_exist():
    used = set(re.findall(r"(?<= )--[a-z-]+", SERVICE[SERVICE.index("ExecStart") :].split("\nEnvironment")[0]))
    assert used
    assert used <= OPTIONS


def test_the_example_of_a_state_line_has_the_fields_of_a_real_one():
    (example,) = re.findall(r"```json\n(.*?)```", PAGE, flags=re.DOTALL)
    shown = json.loads(example)
    advice = ShownAdvice("bend", ADVICE, expires_s=10.0)
    real = state_line((SectionAhead("bend", "near", ""),), (advice,), source="running", now_s=0.0, sequence_number=1)
    assert shown.keys() == real.keys()
    assert shown["sections"][0].keys() == real["sections"][0].keys()
    assert shown["advice"][0].keys() == real["advice"][0].keys()


def test_every_whereabouts_that_is_told_is_explained():
    told = {w.value for w in Whereabouts if not w.over} - {"away"}
    assert {word for word in told if f"`{word}`" not in PAGE} == set()


@pytest.mark.parametrize(
    ("what", "bound"),
    [
        ("sections remembered; maps in memory", f"{LINES_LIMIT_COUNT}; {MAPS_LIMIT_COUNT}"),
        ("passes at one time", f"{PASSES_LIMIT_COUNT}"),
        ("runs of the pipeline in a pass", f"{TRIES_LIMIT_COUNT}"),
        ("spool", f"{CAPACITY_COUNT} summaries"),
        ("listing over cellular", f"1 MB, {SECTIONS_LIMIT_COUNT} sections"),
        ("dashboard", f"{READERS_LIMIT_COUNT} readers"),
    ],
)
def test_the_table_of_bounds_tells_the_bounds(what: str, bound: str):
    assert f"| {what} | {bound}" in PAGE
