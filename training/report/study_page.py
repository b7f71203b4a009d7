"""Headlines and claims for a page that tells of the study, made from the small files that a repository keeps of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from roadgrip.errors import ConfigurationError
from training.report.small_files import INDEX_FILE_NAME, SUMMARY_FILE_NAME, headlines_table
from training.report.wording import CLAIM_MARKS
from training.study.chapter import Claim
from training.study.registry import CHAPTER_MODULES, Part

HEADLINES_TABLE = "study.headlines"
CLAIMS_TABLES = {Part.PAPER: "study.paper", Part.GENERALISE: "study.generalise"}
_CHAPTER_FILE_NAME = "chapter.json"


def study_tables(results: Path, *, link: str) -> Callable[[str], str | None]:
    """Return what a page has between its marks (`training.marked_tables.with_tables`).

    Args:
        results: The folder of all chapters.
        link: How the page names that folder.

    Raises:
        ConfigurationError: There are no results.
    """
    try:
        summary: dict[str, Any] = json.loads((results / SUMMARY_FILE_NAME).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"no results of a study in {results}: {error}") from error
    parts = {name: part for part, name in CLAIMS_TABLES.items()}

    def table_named(name: str) -> str | None:
        if name == HEADLINES_TABLE:
            return headlines_table(summary) + "\n"
        return _claims(results, parts[name], link=link) if name in parts else None

    return table_named


def _claims(results: Path, part: Part, *, link: str) -> str:
    """Return what became of the claims of a part, chapter by chapter, as Markdown."""
    told = []
    for name in CHAPTER_MODULES[part]:
        path = results / name / _CHAPTER_FILE_NAME
        if not path.is_file():
            continue
        chapter = json.loads(path.read_text(encoding="utf-8"))
        told.append(f"### [{chapter['title']}]({link}/{name}/{INDEX_FILE_NAME})")
        if part is Part.PAPER:
            if chapter["paper_says"]:
                told.append(f"> The paper: {' '.join(chapter['paper_says'].split())}")
            if chapter["claim"] is not None:
                claim = Claim(chapter["claim"])
                told.append(f"**{CLAIM_MARKS[claim]} {claim.value}**")
        told.append(" ".join((chapter["verdict"] or "No verdict.").split()))
    return "\n\n".join(told) + "\n"
