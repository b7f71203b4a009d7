"""Made-up drives and linear bundles that know their friction, well or badly, for tests of the gate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from roadgrip.bundle import MANIFEST_NAME, BundleManifest, Conformal, Envelope, ModelManifest, bundle_id_of
from roadgrip.bundle_json import manifest_to_json
from roadgrip.features import GRIP_TABLE, PAPER_TABLE, FeatureTable
from tests.bundles import CONFORMAL, error_onnx, linear_onnx, make_model, manifest_of
from training.dataset import COMPLETED, LABEL_COLUMNS, Runs
from training.gate.contender import Case, Contender, answers_of, read_contender
from training.gate.thresholds import Thresholds, default_thresholds

GOOD: Mapping[str, float] = {"grip_all_best_mu": 1.0}
"""Weights of a model that takes the physical inverse at its word; it is off by some 5 %."""
WRONG_SIGN: Mapping[str, float] = {**GOOD, "sideslip_max_rad": 1.0}
"""The same, but more sideslip means more grip."""
GOOD_OF_PAPER: Mapping[str, float] = {"speed_mean_mps": 0.02}
NOISE_RATIO = 0.06
STRANGE_STEER_RAD = 0.9


def drives(
    role: str,
    *,
    roads_count: int = 12,
    frictions_mu: tuple[float, ...] = (0.3, 0.6),
    runs_count: int = 30,
    seed: int = 1,
    noise_ratio: float = NOISE_RATIO,
) -> Runs:
    """Return drives whose inverse and speed tell the friction up to noise; those of manoeuvres steer wildly."""
    rng = np.random.default_rng(seed)
    count = roads_count * len(frictions_mu) * runs_count
    base_mu = np.tile(np.repeat(frictions_mu, runs_count), roads_count)
    label_mu = base_mu * rng.uniform(0.8, 1.0, count)
    told_mu = label_mu * np.exp(rng.normal(0.0, noise_ratio, count))
    table = GRIP_TABLE
    features = np.tile(np.clip(np.zeros(len(table)), table.minimum, table.maximum), (count, 1))
    features[:, table.index("grip_all_best_mu")] = told_mu
    features[:, table.index("speed_mean_mps")] = 50.0 * told_mu
    features[:, table.index("sideslip_max_rad")] = rng.uniform(0.02, 0.06, count)
    features[:, table.index("steer_max_rad")] = STRANGE_STEER_RAD if role == "manoeuvres" else 0.1
    road = [f"{role}-{number:02d}" for number in range(roads_count) for _ in range(count // roads_count)]
    labels = {name: np.ones(count) for name in LABEL_COLUMNS}
    labels |= {
        "label_mu": label_mu,
        "base_friction_mu": base_mu,
        "peak_utilisation_ratio": rng.uniform(0.1, 1.0, count),
    }
    return Runs(
        features=features.astype(np.float32).astype(np.float64),
        labels=labels,
        scenario=tuple(road),
        section_id=tuple(road),
        outcome=(COMPLETED,) * count,
        run_key=tuple(f"{role}/{number:05d}" for number in range(count)),
        table=table,
    )


def holdouts() -> dict[str, Runs]:
    """Return drives for every role that is required."""
    return {
        "known_roads": drives("known_roads", roads_count=2, frictions_mu=(0.3, 0.45, 0.6), runs_count=40, seed=1),
        "unseen_roads": drives("unseen_roads", seed=2),
        "manoeuvres": drives("manoeuvres", roads_count=1, runs_count=120, seed=3),
    }


def model_of(
    *,
    weights: Mapping[str, float],
    table: FeatureTable = GRIP_TABLE,
    bias_mu: float = 0.0,
    conformal: Conformal | None = CONFORMAL,
    section_id: str | None = None,
) -> tuple[ModelManifest, dict[str, bytes]]:
    """Return a model that calls wild steering strange, and its files."""
    lower, upper = table.minimum.copy(), table.maximum.copy()
    upper[table.index("steer_max_rad")] = 0.5
    envelope = Envelope(tuple(lower.tolist()), tuple(upper.tolist()), outside_allowed_count=0)
    made = make_model(weights=weights, bias_mu=bias_mu, table=table, envelope=envelope, conformal=conformal)
    prefix = "" if section_id is None else f"{section_id}-"
    made = replace(
        made,
        section_id=section_id,
        model_file=f"{prefix}{made.model_file}",
        error_model_file=None if made.error_model_file is None else f"{prefix}{made.error_model_file}",
    )
    files = {made.model_file: linear_onnx(weights=weights, bias_mu=bias_mu, table=table)}
    if made.error_model_file is not None:
        files[made.error_model_file] = error_onnx(table)
    return made, files


def write(folder: Path, *models: tuple[ModelManifest, dict[str, bytes]], **said: str) -> BundleManifest:
    """Write a bundle of some models, with what it says of how it came about."""
    manifests = [manifest for manifest, _ in models]
    files = {name: content for _, held in models for name, content in held.items()}
    manifest = replace(manifest_of(manifests, files), provenance={"made_by": "a test", **said})
    assert manifest.bundle_id == bundle_id_of(manifests, manifest.files_sha256)
    folder.mkdir(parents=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    (folder / MANIFEST_NAME).write_text(manifest_to_json(manifest), encoding="utf-8")
    return manifest


def contender(
    folder: Path,
    *,
    weights: Mapping[str, float] = GOOD,
    bias_mu: float = 0.0,
    conformal: Conformal | None = CONFORMAL,
    of_paper: Mapping[str, float] | None = None,
) -> Contender:
    """Return a bundle of one linear model for the newest table, and one for the paper's if weights are given."""
    models = [model_of(weights=weights, bias_mu=bias_mu, conformal=conformal)]
    if of_paper is not None:
        models.append(model_of(weights=of_paper, table=PAPER_TABLE, conformal=conformal))
    write(folder, *models)
    return read_contender(folder)


def thresholds() -> Thresholds:
    """Return the packaged thresholds with less work, and without parity: a linear model was never a tree."""
    packaged = default_thresholds()
    return replace(
        packaged,
        paired=replace(packaged.paired, replicates_count=300),
        parity=replace(packaged.parity, required=False),
        speed=replace(packaged.speed, calls_count=3),
    )


def case(
    role: str, runs: Runs, challenger: Contender, champion: Contender | None = None, label_sd_mu: float | None = None
) -> Case:
    """Return a hold-out with what both say of it."""
    ours = answers_of(challenger, runs)
    assert ours is not None
    theirs = None if champion is None else answers_of(champion, runs)
    return Case(role, runs, ours, theirs, None if label_sd_mu is None else np.full(len(runs), label_sd_mu))
