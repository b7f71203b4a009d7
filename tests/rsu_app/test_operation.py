from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from pathlib import Path

import pytest

from rsu_app.bootstrap import Parts, build, load_sections
from rsu_app.observability import Metrics
from rsu_app.operation import one_line, unit_status
from rsu_app.ports import WriterPulse
from rsu_app.settings import load_settings
from rsu_app.usecases import Check
from tests.bundles import make_bundle
from tests.rsu_app.fakes import FakeStore

STUCK = WriterPulse(committed_ago_s=42.0, busy_s=42.0, queued_count=7)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    make_bundle(tmp_path / "bundle")
    path = tmp_path / "rsu.toml"
    path.write_text('[database]\npath = "rsu.sqlite3"\n[model]\nbundle_path = "bundle"\n')
    return path


def parts_of(config: Path) -> Parts:
    settings = load_settings(config)
    return build(settings, metrics=Metrics(version="0", section_ids=["long-turn"]), sections=load_sections(settings))


def with_store(parts: Parts, pulse: WriterPulse) -> Parts:
    store = FakeStore()
    store.pulse = pulse
    return replace(parts, store=store)


def test_a_status_is_json_and_holds_all_that_an_operator_looks_at(config):
    async def story():
        parts = parts_of(config)
        try:
            return await unit_status(parts)
        finally:
            await parts.unit.close()

    said = json.loads(json.dumps(asyncio.run(story()), allow_nan=False))
    assert {"sections", "model", "passages", "traffic", "clock", "disk", "process", "conditions"} <= set(said)
    assert said["disk"]["passages_count"] == 0
    assert said["disk"]["free_bytes"] > 0
    assert said["sections"][0]["confidence"] == "insufficient"


def test_a_condition_of_the_door_is_one_of_the_unit_s(config):
    trouble = Check("operators", ok=False, detail="the file with the tokens cannot be read")

    async def story():
        parts = parts_of(config)
        try:
            return await unit_status(parts, door_checks=[trouble])
        finally:
            await parts.unit.close()

    said = asyncio.run(story())
    assert not said["ready"]
    assert {"name": "operators", "ok": False, "required": True, "detail": trouble.detail} in said["conditions"]


def test_the_status_of_a_unit_whose_disk_hangs_does_not_hang_with_it(config):
    async def story():
        parts = parts_of(config)
        try:
            return await unit_status(with_store(parts, STUCK))
        finally:
            await parts.unit.close()

    said = asyncio.run(story())
    assert not said["ready"]
    assert [c["detail"] for c in said["conditions"]] == ["the same write has been under way for 42 s"]
    assert said["disk"]["passages_count"] is None
    assert said["disk"]["queued_count"] == 7


@pytest.mark.parametrize(("committed_ago_s", "told"), [(3.0, "last commit 3 s ago"), (None, "no commit yet")])
def test_one_line_tells_how_the_unit_is(config, committed_ago_s, told):
    async def story():
        parts = parts_of(config)
        try:
            pulse = WriterPulse(committed_ago_s=committed_ago_s, busy_s=0.0, queued_count=0)
            return one_line(with_store(parts, pulse))
        finally:
            await parts.unit.close()

    line = asyncio.run(story())
    assert line.startswith("serving; long-turn: 0 vehicles, 60 km/h; bundle ")
    assert line.endswith(told)
