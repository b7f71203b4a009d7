"""The commands of the pages: every one exists as it is written, and the cheap ones do what the page says."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main

import rsu_app.cli.main
import training.cli
import vehicle_client.cli
from tests.system.daemons import Daemon

PROGRAMS: dict[str, Any] = {
    "roadgrip-rsu": typer.main.get_command(rsu_app.cli.main.app),
    "roadgrip-vehicle": typer.main.get_command(vehicle_client.cli.app_of()),
    "roadgrip-train": typer.main.get_command(training.cli.app),
}
FENCE = re.compile(r"^```(?:sh|console)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def pages(root: Path) -> list[Path]:
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=root, capture_output=True, text=True, check=True).stdout
    return [root / name for name in listed.split()]


def blocks(page: Path) -> list[str]:
    """The fenced blocks of a page as a shell takes them: without prompts, and without what is printed."""
    return [
        "\n".join(line.removeprefix("$ ") for line in block.splitlines() if not line.startswith("{")) + "\n"
        for block in FENCE.findall(page.read_text(encoding="utf-8"))
    ]


def block_with(page: Path, words: str) -> str:
    (found,) = [block for block in blocks(page) if words in block]
    return found


def commands(root: Path) -> Iterator[tuple[str, list[str]]]:
    """Every command line of ours, in fences and in running text, with the page it stands on."""
    for page in pages(root):
        text = page.read_text(encoding="utf-8")
        for line in (
            ("".join(blocks(page)) + "\n".join(re.findall(r"`([^`\n]+)`", text))).replace("\\\n", " ").splitlines()
        ):
            call = re.search(r"(?:^|\s)(roadgrip-(?:rsu|vehicle|train)\b[^|>&;#']*)", line)
            if call:
                yield page.name, shlex.split(call[1])


def unknown_in(words: list[str]) -> str | None:
    """The first word that the program does not know, if any."""
    command: Any = PROGRAMS[words[0]]
    for word in words[1:]:
        if word.startswith("-"):
            known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
            if word not in known:
                return f"{words[0]} {command.name}: {word}"
        elif hasattr(command, "commands"):
            if word not in command.commands:
                return f"{words[0]}: {word}"
            command = command.commands[word]
    return None


def run(block: str, folder: Path) -> str:
    """Run lines of a page as a person at a shell would; return what they print."""
    ways = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block],
        cwd=folder,
        env={**os.environ, "PATH": ways, "COLUMNS": "150"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_every_command_of_a_page_is_one_the_programs_know(project_root):
    found = list(commands(project_root))
    assert {words[0] for _, words in found} == set(PROGRAMS)
    assert [f"{page}: {unknown}" for page, words in found if (unknown := unknown_in(words))] == []


def test_a_command_that_nobody_knows_would_be_found():
    assert unknown_in(["roadgrip-rsu", "section", "import", "--no-such"]) is not None
    assert unknown_in(["roadgrip-rsu", "sections"]) is not None


def test_every_chore_of_a_page_is_one_of_the_makefile(project_root):
    makefile = (project_root / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z][a-z-]*):", makefile, flags=re.MULTILINE))
    text = "".join(page.read_text(encoding="utf-8") for page in pages(project_root))
    named = set(re.findall(r"(?:^|`|\$ )make ([a-z][a-z-]*)", text, flags=re.MULTILINE))
    assert "demo" in named
    assert named - targets == set()


@pytest.mark.system
def test_the_page_on_vehicles_makes_a_drive_and_reads_it(project_root, tmp_path):
    printed = run(block_with(project_root / "docs" / "vehicle.md", "replay drive.csv.gz"), tmp_path)
    assert "nothing was sent" in printed
    assert (tmp_path / "drive.csv.gz").exists()


@pytest.mark.system
def test_the_page_on_vehicles_goes_from_a_can_log_to_a_sent_summary(project_root, tmp_path):
    page = project_root / "docs" / "vehicle.md"
    printed = run(block_with(page, "roadgrip-vehicle signals"), tmp_path)
    assert "nothing was sent" in printed
    with Daemon(tmp_path) as unit:
        block = block_with(page, "--section rsu:long-turn")
        printed = run(block.replace("udp://127.0.0.1:4740", unit.url), tmp_path)
    assert "accepted" in printed


@pytest.mark.system
@pytest.mark.parametrize("speed_kmh", [100, *(pytest.param(speed, marks=pytest.mark.long) for speed in (90, 110))])
def test_the_page_on_vehicles_draws_two_drives(project_root, tmp_path, speed_kmh):
    block = block_with(project_root / "docs" / "vehicle.md", "--second-friction")
    assert "--speed 100 " in block
    # The page says how far its story reaches.
    printed = run(block.replace("--speed 100 ", f"--speed {speed_kmh} "), tmp_path)
    kept, spun = printed.split("picture: drive.png")
    assert "completed" in kept
    assert "spun at" in spun
    assert all((tmp_path / name).stat().st_size > 0 for name in ("drive.png", "spun.png"))


@pytest.mark.system
def test_the_page_on_sections_lists_and_draws(project_root, tmp_path):
    block = block_with(project_root / "docs" / "sections.md", "section list")
    shown = run("".join(line + "\n" for line in block.splitlines() if "import" not in line), tmp_path)
    # The page's table of sizes and the program tell one figure.
    assert "833 bytes in 1 frame" in shown
    assert "| 833 |" in (project_root / "docs" / "wire.md").read_text(encoding="utf-8")
    assert (tmp_path / "long-turn.png").stat().st_size > 0


@pytest.mark.system
def test_the_page_on_the_http_interface_sends_a_passage(project_root, tmp_path):
    page = project_root / "docs" / "http-api.md"
    with Daemon(tmp_path) as unit:
        block = block_with(page, "passage.json").replace("http://127.0.0.1:8080", unit.url)
        receipt = json.loads(run(block, tmp_path).splitlines()[-1])
        asked = [line for line in block_with(page, "roadgrip-rsu serve").splitlines() if "curl -s " in line]
        answers = run("\n".join(asked).replace("http://127.0.0.1:8080", unit.url), tmp_path)
    assert receipt["outcome"] == "accepted"
    assert '"section_id": "long-turn"' in answers
    assert '"reason":"winter_speed_few_vehicles"' in answers


@pytest.mark.long
@pytest.mark.system
def test_the_page_on_the_laboratory_ends_with_a_bundle_a_unit_takes(project_root, tmp_path):
    four_steps = block_with(project_root / "docs" / "laboratory.md", "roadgrip-train export")
    short = four_steps.replace("--runs 100", "--runs 2 --workers 1").replace("train fit", "train fit --trees 40")
    run(short, tmp_path)
    checked = run("ROADGRIP_MODEL__BUNDLE_PATH=build/bundle roadgrip-rsu config check", tmp_path)
    assert "roadgrip-global" in checked


@pytest.mark.long
@pytest.mark.system
def test_the_page_on_other_peoples_drives_writes_some_and_evaluates_them(project_root, tmp_path):
    page = project_root / "docs" / "evaluate.md"
    printed = run(block_with(page, "evaluate --example"), tmp_path)
    assert "counted" in printed
    assert sorted(path.name for path in (tmp_path / "report").iterdir()) == [
        "passages.csv",
        "report.html",
        "report.json",
    ]
    raw = block_with(page, "simulate --design paper")
    short = raw.replace("--design paper --runs 2", "--section sharp-turn --runs 1 --workers 1")
    assert "sharp-turn, base friction 0.70" in run(short, tmp_path)
