"""What the pages promise a reader: links that lead somewhere, and the default bundle's own figures."""

import json
import re
import subprocess
from fnmatch import fnmatchcase

from roadgrip.bundle_json import manifest_from_json
from roadgrip.features import NEWEST_TABLE
from training.bundle_card import CARD_NAME, card_of
from training.marked_tables import marks_of, with_tables
from training.report.study_page import CLAIMS_TABLES, HEADLINES_TABLE, study_tables

LINK = re.compile(r"\]\((?!https?:|mailto:)([^)#\s]*)(?:#([^)\s]+))?\)")


def pages(project_root):
    listed = subprocess.run(
        ["git", "ls-files", "*.md"], cwd=project_root, capture_output=True, text=True, check=True
    ).stdout.split()
    assert "README.md" in listed
    return [project_root / name for name in listed]


def anchors_of(text):
    """The anchors that headings get: lower case, words joined by hyphens, everything else dropped."""
    headings = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def test_every_link_of_every_page_leads_somewhere(project_root):
    broken = []
    for page in pages(project_root):
        for target, anchor in LINK.findall(page.read_text(encoding="utf-8")):
            place = (page.parent / target).resolve() if target else page
            if not place.exists():
                broken.append(f"{page.name}: {target}")
            elif anchor and place.suffix == ".md" and anchor not in anchors_of(place.read_text(encoding="utf-8")):
                broken.append(f"{page.name}: {target}#{anchor}")
    assert broken == []


def test_every_page_can_be_reached_from_the_readme(project_root):
    reached, ahead = set(), [project_root / "README.md"]
    while ahead:
        page = ahead.pop()
        if page in reached or page.suffix != ".md" or not page.exists():
            continue
        reached.add(page)
        ahead += [(page.parent / t).resolve() for t, _ in LINK.findall(page.read_text(encoding="utf-8")) if t]
    assert sorted(str(p.relative_to(project_root)) for p in set(pages(project_root)) - reached) == []


def test_the_card_of_the_default_bundle_is_what_its_manifest_says(project_root):
    folder = project_root / "rsu_app" / "default_bundle"
    manifest = manifest_from_json((folder / "manifest.json").read_text(encoding="utf-8"))
    page = (project_root / "docs" / "laboratory.md").read_text(encoding="utf-8")
    assert marks_of(page[page.index("## The default bundle") :])[:1] == [CARD_NAME]
    assert with_tables(page, {CARD_NAME: card_of(manifest)}.get) == page, "make bundle, or roadgrip-train card --into"
    assert (folder / "card.md").read_text(encoding="utf-8").endswith(card_of(manifest))


def test_the_page_of_the_study_tells_what_its_results_say(project_root):
    page = (project_root / "docs" / "study.md").read_text(encoding="utf-8")
    assert sorted(marks_of(page)) == sorted([HEADLINES_TABLE, *CLAIMS_TABLES.values()])
    tables = study_tables(project_root / "docs" / "results" / "study", link="results/study")
    assert with_tables(page, tables) == page, "roadgrip-train study page docs/study.md"


def test_the_kept_study_is_the_whole_one_and_nothing_is_wrong_with_it(project_root):
    summary = json.loads((project_root / "docs" / "results" / "study" / "summary.json").read_text(encoding="utf-8"))
    assert not summary["quick"]
    assert [summary[name] for name in ("missing", "contested", "unknown", "defects")] == [[], [], [], []]


def test_every_feature_is_named_in_the_nomenclature_and_nothing_else_is(project_root):
    page = (project_root / "docs" / "nomenclature.md").read_text(encoding="utf-8")
    rows = [line for line in page[page.index("## The feature table") :].splitlines() if line.startswith("| `")]
    named = [name for row in rows for name in re.findall(r"`([a-z0-9_*]+)`", row.split("|")[1])]
    unnamed = [name for name in NEWEST_TABLE.names if not any(fnmatchcase(name, pattern) for pattern in named)]
    stale = [pattern for pattern in named if not any(fnmatchcase(name, pattern) for name in NEWEST_TABLE.names)]
    assert (unnamed, stale) == ([], [])
