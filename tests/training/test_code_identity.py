"""Runs of yesterday's code are not taken for today's."""

import sys

import pytest

from training.code_identity import code_digest, function_digest, sources_of
from training.simulation import DRIVING_MODULES


@pytest.fixture
def package(tmp_path, monkeypatch):
    # A stand-in for one of ours: the digest follows imports inside it.
    folder = tmp_path / "training_stand_in"
    folder.mkdir()
    (folder / "__init__.py").write_text("", encoding="utf-8")
    (folder / "outer.py").write_text("from training_stand_in.inner import NUMBER\nimport json\n", encoding="utf-8")
    (folder / "inner.py").write_text("NUMBER = 1\n", encoding="utf-8")
    (folder / "alone.py").write_text("NUMBER = 1\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr("training.code_identity._OURS", ("training_stand_in",))
    yield folder
    code_digest.cache_clear()
    for name in [name for name in sys.modules if name.startswith("training_stand_in")]:
        del sys.modules[name]


def digest() -> str:
    code_digest.cache_clear()
    return code_digest("training_stand_in.outer")


@pytest.mark.parametrize("edited", ["outer.py", "inner.py"])
def test_an_edit_of_a_module_or_of_what_it_imports_is_seen(package, edited):
    before = digest()
    path = package / edited
    path.write_text(path.read_text(encoding="utf-8") + "OTHER = 2\n", encoding="utf-8")
    assert digest() != before


def test_comments_and_modules_that_nobody_imports_do_not_count(package):
    before = digest()
    (package / "inner.py").write_text("# why\nNUMBER   = 1\n", encoding="utf-8")
    (package / "alone.py").write_text("NUMBER = 2\n", encoding="utf-8")
    assert digest() == before


@pytest.mark.sim
def test_what_drives_a_run_is_reached():
    reached = set(sources_of(DRIVING_MODULES))
    assert {
        "roadgrip.features",
        "roadgrip.section",
        "training.scenarios",
        "training.manoeuvres",
        "rsu_app.domain.advisory",
        "vehicle_client.estimation.observer",
        "vehicle_client.mapmatch.gnss",
        "vehicle_client.simulator.sensors",
        "vehicle_client.simulator.tyre",
    } <= reached
    assert not any(name.startswith(("rsu_app.adapters", "roadgrip.wire")) for name in reached)


CHAPTER_TEXT = """
from training_stand_in.inner import NUMBER, OTHER
from training_stand_in.alone import WORDS

FACTOR = 2

def compute():
    return _half() * FACTOR

def _half():
    return NUMBER / 2

def verdict():
    return WORDS + str(OTHER)
"""


@pytest.fixture
def chapter(package):
    (package / "chapter.py").write_text(CHAPTER_TEXT, encoding="utf-8")
    return package / "chapter.py"


def digest_of_compute() -> str:
    code_digest.cache_clear()
    function_digest.cache_clear()
    return function_digest("training_stand_in.chapter", "compute")


@pytest.mark.parametrize("edit", ["FACTOR = 3", "NUMBER / 3", "import NUMBER as NUMBER, OTHER"])
def test_an_edit_of_what_a_function_reaches_is_seen(chapter, edit):
    before = digest_of_compute()
    replaced = {"FACTOR = 3": "FACTOR = 2", "NUMBER / 3": "NUMBER / 2"}.get(edit, "import NUMBER, OTHER")
    chapter.write_text(CHAPTER_TEXT.replace(replaced, edit), encoding="utf-8")
    assert digest_of_compute() != before


def test_an_edit_of_what_a_function_imports_is_seen(chapter):
    before = digest_of_compute()
    (chapter.parent / "inner.py").write_text("NUMBER = 5\n", encoding="utf-8")
    assert digest_of_compute() != before


def test_what_stands_beside_a_function_does_not_count(chapter):
    before = digest_of_compute()
    (chapter.parent / "alone.py").write_text("WORDS = 'new'\n", encoding="utf-8")
    chapter.write_text(CHAPTER_TEXT.replace("str(OTHER)", "repr(OTHER)"), encoding="utf-8")
    assert digest_of_compute() == before


def test_what_a_module_does_besides_defining_counts(chapter):
    before = digest_of_compute()
    chapter.write_text(CHAPTER_TEXT + "\nFACTOR += 1\n", encoding="utf-8")
    assert digest_of_compute() != before
