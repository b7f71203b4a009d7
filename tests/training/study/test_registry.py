"""Every chapter that is written is part of the study."""

import ast
from importlib.util import find_spec
from pathlib import Path

import pytest

import training.study
from training.study.datasets import DATA_SETS
from training.study.registry import CHAPTER_MODULES, Part, chapters_of
from vehicle_client.simulator.plan import SensorGrade

FOLDER = Path(training.study.__file__).parent


def has_a_chapter(path: Path) -> bool:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return any(
        isinstance(node, ast.Assign | ast.AnnAssign)
        and any(isinstance(name, ast.Name) and name.id == "CHAPTER" for name in ast.walk(node))
        for node in tree.body
    )


@pytest.mark.parametrize("part", Part)
def test_every_module_with_a_chapter_is_registered(part):
    written = {path.stem for path in (FOLDER / part.value).glob("*.py") if has_a_chapter(path)}
    assert written == set(CHAPTER_MODULES[part])


@pytest.mark.parametrize("part", Part)
def test_every_registered_chapter_is_there(part):
    assert all(find_spec(f"training.study.{part.value}.{name}") for name in CHAPTER_MODULES[part])


def test_chapters_have_names_of_their_own_and_data_sets_that_there_are():
    chapters = [chapter for part in Part for chapter in chapters_of(part)]
    names = [chapter.name for chapter in chapters]
    assert len(set(names)) == len(names)
    assert {name for chapter in chapters for name in chapter.needed(SensorGrade.AUTOMOTIVE)} <= {
        known.name for known in DATA_SETS
    }
