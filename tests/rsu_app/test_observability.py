import io
import json
import logging
from collections.abc import Iterator

import pytest
import structlog

from rsu_app.observability import LineBudget, Metrics, configure_logging, metrics_table


def test_the_operators_page_holds_the_table_of_metrics(project_root):
    assert metrics_table() in (project_root / "deploy/README.md").read_text(encoding="utf-8")


def test_every_exposed_metric_is_documented():
    metrics = Metrics(version="0", section_ids=["bend"])
    documented = {row.name for row in metrics.rows()}
    exposed = {family.name + ("_total" if family.type == "counter" else "") for family in metrics.registry.collect()}
    assert {name for name in exposed if not name.startswith("process_")} == documented


def test_every_metric_says_what_it_is():
    assert [row.name for row in Metrics(version="0", section_ids=[]).rows() if not row.meaning.endswith(".")] == []


def test_the_label_of_a_strange_section_is_always_the_same():
    metrics = Metrics(version="0", section_ids=["bend"])
    assert [metrics.section_label(s) for s in ("bend", "a", "b")] == ["bend", "other", "other"]


class Time:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_lines_above_the_budget_are_dropped_and_counted():
    now, dropped = Time(), []
    budget = LineBudget(3.0, lambda: dropped.append(1), now)

    def passed(count: int, method: str = "info") -> int:
        through = 0
        for _ in range(count):
            try:
                budget(None, method, {})
                through += 1
            except structlog.DropEvent:
                pass
        return through

    assert passed(10) == 3
    assert len(dropped) == 7
    assert passed(10, "warning") == 10
    now.now_s = 1.0
    assert passed(10) == 3


@pytest.fixture
def lines(monkeypatch) -> Iterator[io.StringIO]:
    root = logging.getLogger()
    handlers, level = root.handlers, root.level
    out = io.StringIO()
    monkeypatch.setattr("sys.stdout", out)
    configure_logging(level="info", style="json", lines_limit_per_s=100.0, on_drop=lambda: None)
    yield out
    root.handlers, root.level = handlers, level
    structlog.reset_defaults()


def test_our_lines_and_those_of_libraries_are_json(lines):
    structlog.get_logger("roadgrip").info("passage", section="bend", outcome="counted")
    structlog.get_logger("roadgrip").debug("not this one")
    logging.getLogger("somebody").warning("careful: %s", "ice")
    ours, theirs = (json.loads(line) for line in lines.getvalue().splitlines())
    assert (ours["event"], ours["section"], ours["level"]) == ("passage", "bend", "info")
    assert (theirs["event"], theirs["logger"], theirs["level"]) == ("careful: ice", "somebody", "warning")


def test_an_exception_is_one_line(lines):
    try:
        int("ice")
    except ValueError:
        logging.getLogger("somebody").exception("slipped")
    (line,) = lines.getvalue().splitlines()
    assert "ice" in json.dumps(json.loads(line))
