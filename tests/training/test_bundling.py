from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roadgrip.bundle import BundleManifest, check_files, manifest_from_json
from roadgrip.errors import BundleError
from tests.training.runs import made_up_runs
from training.bundling import learn_envelope, write_bundle
from training.export import onnx_estimate_mu
from training.regressor import FitParameters, fit


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, BundleManifest]:
    folder = tmp_path_factory.mktemp("bundle")
    runs = made_up_runs(1500)
    fitted = fit(runs, FitParameters(trees_count=40))
    manifest = write_bundle(
        runs, fitted, folder, name="test", provenance={"command": "a test"}, rng=np.random.default_rng(2)
    )
    return folder, manifest


def test_a_bundle_reads_back_as_it_was_written(bundle: tuple[Path, BundleManifest]) -> None:
    folder, manifest = bundle
    assert manifest_from_json((folder / "manifest.json").read_text()) == manifest
    check_files(manifest, {"model.onnx": (folder / "model.onnx").read_bytes()})


def test_one_flipped_bit_in_the_model_is_seen(bundle: tuple[Path, BundleManifest]) -> None:
    folder, manifest = bundle
    content = bytearray((folder / "model.onnx").read_bytes())
    content[len(content) // 2] ^= 1
    with pytest.raises(BundleError, match="differs from its digest"):
        check_files(manifest, {"model.onnx": bytes(content)})


def test_golden_vectors_are_what_the_model_answers(bundle: tuple[Path, BundleManifest]) -> None:
    folder, manifest = bundle
    answers = onnx_estimate_mu((folder / "model.onnx").read_bytes(), np.array(manifest.golden.rows))
    assert answers == pytest.approx(np.array(manifest.golden.mu), abs=1e-7)


def test_the_manifest_says_how_the_model_came_about(bundle: tuple[Path, BundleManifest]) -> None:
    _, manifest = bundle
    assert manifest.provenance["command"] == "a test"
    assert len(manifest.provenance["dataset_digest"]) == 16
    assert 0.0 < manifest.metrics["mape_ratio"] < 1.0


def outside_count(rows: np.ndarray, lower: tuple[float, ...], upper: tuple[float, ...]) -> np.ndarray:
    outside = (rows < np.array(lower)) | (rows > np.array(upper))
    return np.asarray(np.count_nonzero(outside, axis=1))


def test_the_envelope_calls_few_ordinary_rows_strange() -> None:
    rng = np.random.default_rng(4)
    envelope = learn_envelope(rng.normal(size=(5000, 78)))
    fresh = outside_count(rng.normal(size=(5000, 78)), envelope.lower, envelope.upper)
    assert np.mean(fresh > envelope.outside_allowed_count) < 0.01


def test_the_envelope_calls_rows_from_elsewhere_strange() -> None:
    rng = np.random.default_rng(4)
    envelope = learn_envelope(rng.normal(size=(5000, 78)))
    elsewhere = outside_count(rng.normal(size=(500, 78)) * 3.0, envelope.lower, envelope.upper)
    assert np.mean(elsewhere > envelope.outside_allowed_count) > 0.99


def test_a_feature_that_never_changed_does_not_make_its_own_value_strange() -> None:
    rows = np.random.default_rng(4).normal(size=(2000, 78))
    rows[:, 77] = np.float32(613.0371)
    envelope = learn_envelope(rows)
    rows[:, 77] = 613.0371
    assert outside_count(rows[:, 77:], envelope.lower[77:], envelope.upper[77:]).sum() == 0
