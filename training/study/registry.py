"""The chapters of the study in the order in which they are read: part A reproduces the paper, part B goes past it."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from importlib import import_module
from types import MappingProxyType

from training.study.chapter import Chapter


class Part(StrEnum):
    """One half of the study."""

    PAPER = "paper"
    GENERALISE = "generalise"


PART_TITLES: Mapping[Part, str] = MappingProxyType(
    {
        Part.PAPER: "The paper, reproduced",
        Part.GENERALISE: "Beyond the paper: roads the model has never seen",
    }
)

# Modules of `training.study.PART`, each with a CHAPTER. Imported when they are asked for: some bring heavy libraries.
CHAPTER_MODULES: Mapping[Part, tuple[str, ...]] = MappingProxyType(
    {
        Part.PAPER: (
            "algorithms",
            "selection",
            "statistics",
            "local_global",
            "interval_accuracy",
            "without",
            "manoeuvres",
            "wear",
            "published",
            "sensitivity",
            "drivers",
        ),
        Part.GENERALISE: (
            "known_roads",
            "unseen_roads",
            "two_frictions",
            "learning_curve",
            "features",
            "sensors",
            "uncertainty",
            "vehicles",
            "pooling",
            "profiles",
            "liars",
            "change",
            "closed_loop",
        ),
    }
)


def chapters_of(part: Part) -> tuple[Chapter, ...]:
    """Return the chapters of a part, in order."""
    return tuple(_chapter(f"training.study.{part.value}.{name}") for name in CHAPTER_MODULES[part])


def _chapter(module_name: str) -> Chapter:
    chapter = import_module(module_name).CHAPTER
    if not isinstance(chapter, Chapter):
        raise TypeError(f"{module_name}.CHAPTER is no chapter")
    return chapter
