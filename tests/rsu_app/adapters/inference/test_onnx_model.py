from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from roadgrip.bundle import MANIFEST_NAME, GoldenVectors, bundle_id_of
from roadgrip.bundle_json import manifest_from_json, manifest_to_json
from roadgrip.errors import BundleError, FeatureTableError
from roadgrip.features import NEWEST_TABLE, PAPER_TABLE
from rsu_app.adapters.inference import OnnxFrictionModel, load_bundle
from tests.bundles import (
    CONFORMAL,
    ERROR_BIAS_RATIO,
    ERROR_NAME,
    ERROR_WEIGHTS,
    MODEL_NAME,
    error_onnx,
    linear_mu,
    linear_onnx,
    make_bundle,
    make_bundle_of_tables,
    make_manifest,
)

DIGEST, WIDTH = NEWEST_TABLE.digest, len(NEWEST_TABLE)
LOW, HIGH = NEWEST_TABLE.minimum, NEWEST_TABLE.maximum
ROW = np.array(make_manifest().models[0].golden.rows[1])


@pytest.fixture
def bundle(tmp_path):
    make_bundle(tmp_path / "bundle")
    return tmp_path / "bundle"


@pytest.fixture(scope="module")
def model():
    content = linear_onnx()
    return OnnxFrictionModel(make_manifest(model=content), {MODEL_NAME: content})


@settings(max_examples=40)
@given(arrays(np.float64, st.tuples(st.integers(1, 5), st.just(WIDTH)), elements=st.floats(0.0, 1.0)))
def test_the_model_answers_one_estimate_per_row(model, shares):
    rows = LOW + shares * (HIGH - LOW)
    assert model.estimate(DIGEST, rows).mu == pytest.approx(linear_mu(rows), abs=1e-6)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1e300, HIGH[40] * 1.001])
def test_a_value_that_no_passage_can_have_never_reaches_the_model(model, value):
    row = ROW.copy()
    row[40] = value
    with pytest.raises(ValueError, match=NEWEST_TABLE.names[40]):
        model.estimate(DIGEST, np.vstack([ROW, row]))


@pytest.mark.parametrize("shape", [(WIDTH,), (1, WIDTH - 1), (1, WIDTH + 1)])
def test_rows_of_another_width_are_refused(model, shape):
    with pytest.raises(ValueError, match=f"{WIDTH} features"):
        model.estimate(DIGEST, np.zeros(shape))


def test_a_bundle_is_loaded_with_its_manifest(bundle):
    model = load_bundle(bundle)
    assert model.manifest == make_manifest()
    assert model.estimate(DIGEST, ROW[None, :]).mu == pytest.approx(linear_mu(ROW[None, :]), abs=1e-6)


def test_a_hidden_file_beside_the_bundle_does_no_harm(bundle):
    (bundle / ".keep").write_text("")
    load_bundle(bundle)


def rewrite(bundle, **changes):
    manifest = make_manifest()
    models = (replace(manifest.models[0], **changes),)
    named = replace(manifest, models=models, bundle_id=bundle_id_of(models, manifest.files_sha256))
    (bundle / MANIFEST_NAME).write_text(manifest_to_json(named))


def test_a_model_changed_by_one_bit_is_refused(bundle):
    content = bytearray((bundle / MODEL_NAME).read_bytes())
    content[len(content) // 2] ^= 1
    (bundle / MODEL_NAME).write_bytes(bytes(content))
    with pytest.raises(BundleError, match="differs from its digest"):
        load_bundle(bundle)


def test_a_file_that_nobody_vouches_for_is_refused(bundle):
    (bundle / "extra.bin").write_bytes(b"?")
    with pytest.raises(BundleError, match=r"extra\.bin"):
        load_bundle(bundle)


def test_a_folder_inside_a_bundle_is_refused(bundle):
    (bundle / "more").mkdir()
    with pytest.raises(BundleError, match="no file that belongs"):
        load_bundle(bundle)


def test_a_missing_model_is_refused(bundle):
    (bundle / MODEL_NAME).unlink()
    with pytest.raises(BundleError, match="its manifest names"):
        load_bundle(bundle)


def test_a_missing_manifest_is_refused(bundle):
    (bundle / MANIFEST_NAME).unlink()
    with pytest.raises(BundleError, match=MANIFEST_NAME):
        load_bundle(bundle)


def test_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(BundleError, match=r"cannot read .*nowhere.* as a bundle: No such file"):
        load_bundle(tmp_path / "nowhere")


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff\xfe", b"[1, 2", b"null"])
def test_a_manifest_that_is_none_is_refused(bundle, content):
    (bundle / MANIFEST_NAME).write_bytes(content)
    with pytest.raises(BundleError):
        load_bundle(bundle)


def test_a_bundle_for_another_feature_table_is_refused_with_both_digests(bundle):
    rewrite(bundle, table_digest="0" * 16)
    with pytest.raises(FeatureTableError, match="0000000000000000"):
        load_bundle(bundle)


def test_a_model_that_answers_otherwise_than_in_the_laboratory_is_refused(bundle):
    golden = make_manifest().models[0].golden
    rewrite(bundle, golden=GoldenVectors(rows=golden.rows, mu=(*golden.mu[:-1], golden.mu[-1] + 2e-5)))
    with pytest.raises(BundleError, match="misses its 4 golden vectors"):
        load_bundle(bundle)


@pytest.mark.parametrize("rows", [((float("nan"),) * WIDTH,), ((1e9,) * WIDTH,)])
def test_golden_vectors_that_cannot_be_are_refused(bundle, rows):
    rewrite(bundle, golden=GoldenVectors(rows=rows, mu=(0.5,)))
    with pytest.raises(BundleError):
        load_bundle(bundle)


@pytest.mark.parametrize("content", [b"", b"not a model", linear_onnx()[:-20]])
def test_bytes_that_are_no_model_are_refused(content):
    with pytest.raises(BundleError, match="is no model"):
        OnnxFrictionModel(make_manifest(model=content), {MODEL_NAME: content})


def test_a_model_of_another_width_is_refused():
    from onnx import TensorProto, helper

    graph = helper.make_graph(
        [helper.make_node("ReduceMean", ["features"], ["mu"], axes=[1])],
        "narrow",
        [helper.make_tensor_value_info("features", TensorProto.FLOAT, [None, 3])],
        [helper.make_tensor_value_info("mu", TensorProto.FLOAT, [None, 1])],
    )
    content = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 15)], ir_version=8).SerializeToString()
    with pytest.raises(BundleError, match=f"not rows of {WIDTH}"):
        OnnxFrictionModel(make_manifest(model=content), {MODEL_NAME: content})


def test_each_table_has_a_model_of_its_own_and_no_other_answers_for_it(tmp_path, wider_table):
    make_bundle_of_tables(tmp_path, (wider_table, PAPER_TABLE), biases_mu=(0.7, 0.3))
    model = load_bundle(tmp_path)
    assert model.manifest.table_digests == (wider_table.digest, PAPER_TABLE.digest)
    for table, bias_mu in ((wider_table, 0.7), (PAPER_TABLE, 0.3)):
        rows = np.clip(np.zeros((3, len(table))), table.minimum, table.maximum)
        assert model.estimate(table.digest, rows).mu == pytest.approx(np.full(3, bias_mu), abs=1e-6)
        with pytest.raises(ValueError, match=f"rows of {len(table)} features"):
            model.estimate(table.digest, rows[:, :-1])
    with pytest.raises(BundleError, match="no model for feature table 0000000000000000"):
        model.estimate("0" * 16, rows)


def test_a_model_for_the_error_answers_beside_the_friction():
    content = {MODEL_NAME: linear_onnx(), ERROR_NAME: error_onnx()}
    model = OnnxFrictionModel(make_manifest(conformal=CONFORMAL), content)
    rows = LOW + 0.6 * (HIGH - LOW) * np.ones((2, 1))
    answers = model.estimate(DIGEST, rows)
    assert answers.mu == pytest.approx(linear_mu(rows), abs=1e-6)
    assert answers.expected_error_ratio == pytest.approx(
        linear_mu(rows, weights=ERROR_WEIGHTS, bias_mu=ERROR_BIAS_RATIO), abs=1e-6
    )


def test_a_bundle_without_a_model_for_the_error_says_nothing_of_it(model):
    assert model.estimate(DIGEST, ROW[None, :]).expected_error_ratio is None


def test_an_error_model_that_answers_otherwise_than_in_the_laboratory_is_refused(tmp_path):
    make_bundle_of_tables(tmp_path, (NEWEST_TABLE,), biases_mu=(0.5,))
    manifest = manifest_from_json((tmp_path / MANIFEST_NAME).read_text())
    golden = manifest.models[0].golden
    assert golden.expected_error_ratio
    first, *others = golden.expected_error_ratio
    models = (replace(manifest.models[0], golden=replace(golden, expected_error_ratio=(first + 2e-5, *others))),)
    wrong = replace(manifest, models=models, bundle_id=bundle_id_of(models, manifest.files_sha256))
    (tmp_path / MANIFEST_NAME).write_text(manifest_to_json(wrong))
    with pytest.raises(BundleError, match="golden vectors of expected error"):
        load_bundle(tmp_path)
