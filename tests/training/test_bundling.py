from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roadgrip.bundle import BundleManifest, check_files
from roadgrip.bundle_json import manifest_from_json
from roadgrip.errors import BundleError
from tests.training.runs import made_up_runs
from training.bundle_card import card_of
from training.bundling import CARD_FILE_NAME, GOLDEN_ROWS_COUNT, learn_envelope, write_bundle
from training.export import onnx_estimate_mu, to_onnx
from training.fit_parameters import FitParameters
from training.regressor import Fitted, fit

RUNS = made_up_runs(1500)
MODEL_FILE = f"friction-v{RUNS.table.version}.onnx"


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    return fit(RUNS, FitParameters(trees_count=40))


def bundled(fitted: Fitted, folder: Path) -> BundleManifest:
    return write_bundle(
        RUNS, fitted, folder, name="test", provenance={"command": "a test"}, rng=np.random.default_rng(2)
    )


@pytest.fixture(scope="module")
def bundle(fitted: Fitted, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, BundleManifest]:
    folder = tmp_path_factory.mktemp("bundle")
    return folder, bundled(fitted, folder)


def files_in(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "manifest.json"}


def test_a_bundle_reads_back_as_it_was_written(bundle: tuple[Path, BundleManifest]) -> None:
    folder, manifest = bundle
    assert manifest_from_json((folder / "manifest.json").read_text()) == manifest
    check_files(manifest, files_in(folder))
    assert set(files_in(folder)) == {MODEL_FILE, CARD_FILE_NAME}


def test_one_flipped_bit_in_the_model_is_seen(bundle: tuple[Path, BundleManifest]) -> None:
    folder, manifest = bundle
    content = bytearray((folder / MODEL_FILE).read_bytes())
    content[len(content) // 2] ^= 1
    with pytest.raises(BundleError, match="differs from its digest"):
        check_files(manifest, {**files_in(folder), MODEL_FILE: bytes(content)})


def test_the_card_of_a_bundle_lies_in_its_folder(bundle: tuple[Path, BundleManifest]) -> None:
    folder, manifest = bundle
    assert (folder / CARD_FILE_NAME).read_text().endswith(card_of(manifest))


def test_golden_vectors_are_what_the_model_answers(bundle: tuple[Path, BundleManifest]) -> None:
    folder, manifest = bundle
    answers = onnx_estimate_mu((folder / MODEL_FILE).read_bytes(), np.array(manifest.models[0].golden.rows))
    assert answers == pytest.approx(np.array(manifest.models[0].golden.mu), abs=1e-7)


def test_golden_vectors_are_passages_the_trees_never_saw(bundle: tuple[Path, BundleManifest], fitted: Fitted) -> None:
    _, manifest = bundle
    unseen = {tuple(row) for row in RUNS.features[fitted.test_rows].astype(np.float32).tolist()}
    assert set(manifest.models[0].golden.rows) <= unseen
    assert len(set(manifest.models[0].golden.rows)) == GOLDEN_ROWS_COUNT


def test_the_envelope_is_learned_from_what_the_trees_learned_from(
    bundle: tuple[Path, BundleManifest], fitted: Fitted
) -> None:
    _, manifest = bundle
    assert manifest.models[0].envelope == learn_envelope(RUNS.features[fitted.train_rows])


def test_an_export_that_answers_otherwise_leaves_nothing_behind(
    fitted: Fitted, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = to_onnx(fitted.booster[:20])
    monkeypatch.setattr("training.bundling.to_onnx", lambda _trees, **_options: other)
    with pytest.raises(BundleError, match="differs from the trained one"):
        bundled(fitted, tmp_path / "bundle")
    assert not (tmp_path / "bundle").exists()


def test_the_manifest_says_how_the_model_came_about(bundle: tuple[Path, BundleManifest]) -> None:
    _, manifest = bundle
    assert manifest.provenance["command"] == "a test"
    assert len(manifest.provenance["dataset_digest"]) == 16
    assert 0.0 < manifest.metrics["mape_ratio"] < 1.0


def outside_count(rows: np.ndarray, lower: tuple[float, ...], upper: tuple[float, ...]) -> np.ndarray:
    outside = (rows < np.array(lower)) | (rows > np.array(upper))
    return np.asarray(np.count_nonzero(outside, axis=1))


def test_a_side_of_the_envelope_is_a_quantile_widened_by_a_twentieth_of_the_span() -> None:
    # 1,001 even steps from 0 to 1: the tails of 0.1 % end at 0.001 and 0.999.
    envelope = learn_envelope(np.tile(np.linspace(0.0, 1.0, 1001)[:, None], (1, 78)))
    assert envelope.lower == pytest.approx((0.001 - 0.05 * 0.998,) * 78, abs=2e-6)
    assert envelope.upper == pytest.approx((0.999 + 0.05 * 0.998,) * 78, abs=2e-6)


def test_one_wild_row_in_a_thousand_does_not_open_the_envelope() -> None:
    rows = np.random.default_rng(4).normal(size=(1000, 78))
    rows[0] = 50.0
    assert learn_envelope(rows).outside_allowed_count < 10


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


@pytest.mark.parametrize("value", [613.0371, -613.0371])
def test_a_feature_that_never_changed_does_not_make_its_own_value_strange(value: float) -> None:
    rows = np.random.default_rng(4).normal(size=(2000, 78))
    rows[:, 77] = np.float32(value)
    envelope = learn_envelope(rows)
    rows[:, 77] = value
    assert outside_count(rows[:, 77:], envelope.lower[77:], envelope.upper[77:]).sum() == 0
