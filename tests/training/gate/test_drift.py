"""Features that are distributed otherwise than in training."""

from dataclasses import replace

import numpy as np

from roadgrip.bundle import TrainingReference
from roadgrip.features import GRIP_TABLE
from tests.training.gate.bouts import GOOD, contender, drives, model_of, thresholds, write
from training.gate.contender import read_contender
from training.gate.drift import drift

LIMITS = thresholds().drift
LEVELS = np.linspace(0.0, 1.0, 21)
LEVELS_MU = tuple(LEVELS.tolist())


def bundle_that_learned(folder, runs):
    quantiles = np.quantile(runs.features, LEVELS, axis=0).T
    known = TrainingReference(None, len(runs), tuple(map(tuple, quantiles.tolist())), LEVELS_MU)
    model, files = model_of(weights=GOOD)
    write(folder, (replace(model, references=(known,)), files))
    return read_contender(folder)


def asked(bundle, runs):
    (check,) = drift(bundle, {"unseen roads": runs}, LIMITS).checks
    return check


def test_drives_like_those_of_training_are_not_flagged(tmp_path):
    bundle = bundle_that_learned(tmp_path / "a", drives("unseen_roads", seed=1))
    assert asked(bundle, drives("unseen_roads", seed=2)).passed


def test_a_feature_that_moved_is_named_and_fails_nobody(tmp_path):
    runs = drives("unseen_roads")
    bundle = bundle_that_learned(tmp_path / "a", runs)
    moved = runs.features.copy()
    moved[:, GRIP_TABLE.index("sideslip_max_rad")] += 0.05
    check = asked(bundle, replace(runs, features=moved))
    assert (check.passed, check.failed) == (False, False)
    assert check.figures["flagged_count"] == 1
    assert check.sentence.endswith("training: sideslip_max_rad")


def test_without_references_nothing_is_said(tmp_path):
    assert "does not say" in asked(contender(tmp_path / "a"), drives("unseen_roads")).sentence


def test_a_section_of_which_something_was_learned_is_held_against_that(tmp_path):
    runs = drives("known_roads", roads_count=2, runs_count=60)
    own = np.array(runs.section_id) == runs.section_id[0]
    moved = runs.features.copy()
    moved[own, GRIP_TABLE.index("sideslip_max_rad")] += 0.05
    here = replace(runs, features=moved)
    over_all, there = (
        TrainingReference(road, len(rows), tuple(map(tuple, np.quantile(rows, LEVELS, axis=0).T.tolist())), LEVELS_MU)
        for road, rows in ((None, runs.features), (runs.section_id[0], moved[own]))
    )
    for name, references, flagged in (("a", (over_all,), True), ("b", (over_all, there), False)):
        model, files = model_of(weights=GOOD)
        write(tmp_path / name, (replace(model, references=references), files))
        assert asked(read_contender(tmp_path / name), here).passed is not flagged
