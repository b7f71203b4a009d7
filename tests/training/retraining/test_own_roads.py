"""Own roads: judged by models that know nothing of them, and models for single sections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.training.many_roads import runs_of_many_roads
from tests.training.retraining.retrained_lab import OWN_ROAD, measured_runs
from training.dataset import DatasetError, joined
from training.fit_parameters import FitParameters
from training.retraining.own_roads import (
    FEWEST_LOCAL_DRIVES,
    MOST_HANDS_COUNT,
    hands_of,
    judged_as_unseen,
    local_drives,
    local_models,
)
from training.table_figures import own_parts_of
from training.table_models import (
    FOLDS_COUNT,
    GrownModel,
    LearnedDrives,
    grown_model,
    learned_drives,
    paper_plan,
    steps_count,
)

RUNS = joined([runs_of_many_roads(700), measured_runs(260)])
DRIVES = learned_drives(RUNS, seed=1, own=np.array(RUNS.section_id) == OWN_ROAD)
OWN = np.array(DRIVES.runs.section_id) == OWN_ROAD
PLAN = paper_plan(FitParameters(trees_count=15, depth_count=4, learning_rate_ratio=0.2))


@pytest.fixture(scope="module")
def model() -> GrownModel:
    return grown_model(DRIVES, PLAN)


def with_own_labels(drives: LearnedDrives, label_mu: float) -> LearnedDrives:
    labels = {**drives.runs.labels, "label_mu": np.where(OWN, label_mu, drives.label_mu)}
    return replace(drives, runs=replace(drives.runs, labels=labels))


def test_who_judges_an_own_road_as_unseen_learned_nothing_there(model: GrownModel) -> None:
    said = judged_as_unseen(DRIVES, model)
    other = with_own_labels(DRIVES, 0.95)
    again = judged_as_unseen(other, model)
    assert again.mu[OWN] == pytest.approx(said.mu[OWN], abs=1e-9)
    assert grown_model(other, PLAN).strangers.mu[OWN].mean() > said.mu[OWN].mean() + 0.1
    assert np.isnan(said.mu[~OWN]).all()
    assert np.isnan(said.expected_error_ratio[~OWN]).all()


def test_every_own_road_is_left_out_once_whole_and_at_most_so_many_times() -> None:
    sections = np.array([f"own-{i % 7}" if own else "random-1" for i, own in enumerate(OWN)])
    drives = replace(DRIVES, runs=replace(DRIVES.runs, section_id=tuple(sections.tolist())), own=OWN)
    hands = hands_of(drives)
    assert len(hands) == MOST_HANDS_COUNT
    assert (np.sum(hands, axis=0) == OWN).all()
    for hand in hands:
        assert not set(sections[hand].tolist()) & set(sections[~hand].tolist())


def test_without_own_roads_nothing_is_grown_again(model: GrownModel) -> None:
    none = replace(DRIVES, own=None)
    assert hands_of(none) == []
    assert own_parts_of(none) == {}
    assert np.isnan(judged_as_unseen(none, model).mu).all()


def test_a_measured_drive_on_a_papers_road_is_judged_without_all_drives_there() -> None:
    sections = tuple("long-turn" if own else name for own, name in zip(OWN, DRIVES.runs.section_id, strict=True))
    drives = replace(DRIVES, runs=replace(DRIVES.runs, section_id=sections))
    (hand,) = hands_of(drives)
    assert hand.sum() == sections.count("long-turn") > OWN.sum()
    assert (own_parts_of(drives)["own_roads.long-turn"] == OWN).all()


def test_a_section_s_model_learns_from_its_drives_alone(model: GrownModel) -> None:
    there = local_drives(DRIVES, OWN_ROAD, seed=1)
    assert set(there.runs.section_id) == {OWN_ROAD}
    assert set(there.fold.tolist()) == set(range(FOLDS_COUNT))
    told: list[int] = []
    (local,) = local_models(there, OWN_ROAD, [model], on_step=told.append)
    assert told == list(range(1, steps_count() + 1))
    assert local.model.conformal.doubtful_above_ratio == model.conformal.doubtful_above_ratio
    assert local.figures()[f"rows_count.local.{OWN_ROAD}.v1"] == OWN.sum()


def test_a_section_needs_many_drives_for_a_model_of_its_own() -> None:
    few = DRIVES.runs.section_id.count("random-01")
    with pytest.raises(DatasetError, match=f"{few} drives on random-01 .* at least {FEWEST_LOCAL_DRIVES}"):
        local_drives(DRIVES, "random-01", seed=1)
