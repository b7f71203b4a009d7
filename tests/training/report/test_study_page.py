"""A page tells what the kept files say, and nothing where they say nothing."""

import pytest

from roadgrip.errors import ConfigurationError
from tests.training.report.test_small_files import finding_of
from tests.training.study.fake_chapters import fake_result
from training.marked_tables import with_tables
from training.report import study_page
from training.report.small_files import write_chapter, write_summary
from training.report.study_page import study_tables
from training.study.headlines import summary
from training.study.registry import Part

PAGE = """# Told

<!-- table: study.headlines -->
<!-- end of table -->
<!-- table: study.paper -->
<!-- end of table -->
<!-- table: study.generalise -->
<!-- end of table -->
<!-- table: another -->
kept
<!-- end of table -->
"""


@pytest.fixture
def results(tmp_path, monkeypatch):
    monkeypatch.setattr(study_page, "CHAPTER_MODULES", {Part.PAPER: ("one", "missing"), Part.GENERALISE: ("two",)})
    findings = {Part.PAPER: [finding_of("one", fake_result())], Part.GENERALISE: [finding_of("two", fake_result())]}
    for chapters in findings.values():
        for finding in chapters:
            write_chapter(finding, tmp_path)
    everything = [finding for chapters in findings.values() for finding in chapters]
    write_summary(findings, summary(everything, seed=1, quick=False, version="1"), tmp_path)
    return tmp_path


def test_a_page_gets_headlines_and_claims_with_links_to_the_chapters(results):
    page = with_tables(PAGE, study_tables(results, link="results/study"))
    assert "| unseen roads, MAPE, full coverage |" in page
    assert "](results/study/one/README.md)" in page
    assert "partly confirmed**" in page
    assert page.count("](results/study/two/README.md)") == 1
    assert "missing" not in page
    assert "\nkept\n" in page


def test_a_page_that_is_written_again_stays_the_same(results):
    tables = study_tables(results, link="results")
    once = with_tables(PAGE, tables)
    assert with_tables(once, tables) == once


def test_without_results_there_is_nothing_to_tell(tmp_path):
    with pytest.raises(ConfigurationError, match="no results of a study"):
        study_tables(tmp_path, link="results")
