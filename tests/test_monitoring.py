"""What watches units names what units expose: alert rules and dashboard against `/metrics`, runbooks against docs."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml  # type: ignore[import-untyped] # its stubs are a package of their own, for one import

from deploy.monitoring.dashboard import DASHBOARD_FILE, ROWS, dashboard_text
from rsu_app.observability import Metrics
from tests.promql import PromqlError, read
from tests.test_docs import anchors_of

FOLDER = Path(__file__).resolve().parents[1] / "deploy" / "monitoring"
RULES_FILE = FOLDER / "roadgrip.rules.yml"
OF_THE_SCRAPE = {"instance", "job"}
PARTS = {"histogram": ("_bucket", "_sum", "_count"), "counter": ("",), "gauge": ("",)}


def exposed() -> dict[str, set[str]]:
    """Every name of a series that a unit exposes, with the labels it may be selected by."""
    metrics = Metrics(version="0", section_ids=["bend"])
    found = {
        row.name + part: set(row.labels) | OF_THE_SCRAPE | ({"le"} if part == "_bucket" else set())
        for row in metrics.rows()
        for part in PARTS[row.kind]
    }
    # Of the process itself, as the library names them; and what Prometheus notes of every scrape.
    for line in metrics.exposition().decode().splitlines():
        if line.startswith("process_"):
            found[line.split()[0]] = set(OF_THE_SCRAPE)
    return found | {"up": set(OF_THE_SCRAPE)}


EXPOSED = exposed()


def rules() -> list[dict[str, Any]]:
    groups = yaml.safe_load(RULES_FILE.read_text(encoding="utf-8"))["groups"]
    return [rule for group in groups for rule in group["rules"]]


def queries() -> list[tuple[str, str]]:
    panels = [panel for _, panels in ROWS for panel in panels]
    shown = [(f"panel {panel.title}", query) for panel in panels for query, _ in panel.series]
    return shown + [(rule["alert"], rule["expr"]) for rule in rules()]


@pytest.mark.parametrize(("name", "text"), queries())
def test_every_metric_and_label_of_a_query_is_exposed(name, text):
    query = read(text)
    unknown = {each.metric for each in query.selectors} - set(EXPOSED)
    assert not unknown
    strange = {
        (each.metric, label) for each in query.selectors for label in each.labels if label not in EXPOSED[each.metric]
    }
    assert not strange
    assert query.grouped <= set().union(*(EXPOSED[each.metric] for each in query.selectors))


@pytest.mark.parametrize("rule", rules(), ids=lambda rule: str(rule["alert"]))
def test_every_placeholder_of_an_alert_is_a_label_of_its_query(rule):
    query = read(rule["expr"])
    named = set(re.findall(r"\$labels\.(\w+)", rule["annotations"]["summary"]))
    carried = set().union(*(EXPOSED[each.metric] for each in query.selectors))
    assert named <= (query.grouped | OF_THE_SCRAPE if " by " in rule["expr"] else carried)


def test_every_alert_leads_to_a_heading_that_says_what_to_do(project_root):
    page = (project_root / "docs" / "monitoring.md").read_text(encoding="utf-8")
    lacking = []
    for rule in rules():
        file, _, anchor = rule["annotations"]["runbook_url"].partition("#")
        if file != "docs/monitoring.md" or anchor not in anchors_of(page) or anchor != rule["alert"].lower():
            lacking.append(rule["alert"])
    assert lacking == []
    told = set(re.findall(r"^### (Roadgrip\w+)$", page, re.MULTILINE))
    assert told == {rule["alert"] for rule in rules()}


def test_every_alert_has_a_name_of_its_own_and_says_how_urgent_it_is():
    names = [rule["alert"] for rule in rules()]
    assert len(names) == len(set(names))
    assert {rule["labels"]["severity"] for rule in rules()} == {"page", "ticket"}


def test_prometheus_reads_the_rules_that_lie_beside_its_settings():
    settings = yaml.safe_load((FOLDER / "prometheus.yml").read_text(encoding="utf-8"))
    assert [(FOLDER / name).exists() for name in settings["rule_files"]] == [True]
    (job,) = settings["scrape_configs"]
    assert (job["job_name"], job["metrics_path"]) == ("roadgrip", "/metrics")


def test_the_dashboard_is_the_one_that_its_table_makes():
    assert DASHBOARD_FILE.read_text(encoding="utf-8") == dashboard_text(), "python -m deploy.monitoring.dashboard"


def test_no_two_panels_of_the_dashboard_lie_on_each_other():
    taken: set[tuple[int, int]] = set()
    for panel in json.loads(dashboard_text())["panels"]:
        place = panel["gridPos"]
        cells = {(place["x"] + x, place["y"] + y) for x in range(place["w"]) for y in range(place["h"])}
        assert not cells & taken
        assert place["x"] + place["w"] <= 24
        taken |= cells


@pytest.mark.parametrize(
    "text",
    ["sum(", "rate(up[5m]", "up{job=roadgrip}", "up{job}", "frobnicate(up)", "up ~ 1", "1 > 0", "rate", "up)"],
)
def test_what_is_no_query_is_told_from_one(text):
    with pytest.raises(PromqlError):
        read(text)


@pytest.mark.skipif(shutil.which("promtool") is None, reason="Prometheus is not installed; our own reader has judged")
def test_prometheus_itself_takes_the_rules():
    done = subprocess.run(["promtool", "check", "rules", str(RULES_FILE)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
