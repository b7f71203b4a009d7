"""The threat model names tests: they are there."""

import json
import re

from bench.liars import report


def test_every_test_that_the_threat_model_names_is_there(project_root):
    page = (project_root / "docs" / "threat-model.md").read_text(encoding="utf-8")
    rows = [line.split("|") for line in page.splitlines() if line.startswith("| ") and line.count("|") == 6]
    named = {path for row in rows for path in re.findall(r"`([a-z_/*.]+)`", row[4])}
    assert len(named) > 20
    assert sorted(path for path in named if not list((project_root / "tests").glob(path.rstrip("/")))) == []


def test_the_table_of_liars_says_what_the_figures_say(project_root):
    figures = json.loads((project_root / "docs" / "results" / "liars.json").read_text(encoding="utf-8"))
    page = (project_root / "docs" / "threat-model.md").read_text(encoding="utf-8")
    assert report(figures) in page
