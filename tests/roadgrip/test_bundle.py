import dataclasses
import hashlib
import json
from math import log

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.bundle import (
    BundleManifest,
    Conformal,
    Envelope,
    GoldenVectors,
    ModelManifest,
    OrdinaryDriving,
    TrainingReference,
    bundle_id_of,
    check_files,
)
from roadgrip.bundle_json import manifest_from_json, manifest_to_json
from roadgrip.envelope import DrivingEnvelope
from roadgrip.errors import BundleError, FeatureTableError
from roadgrip.features import PAPER_TABLE, FeatureTable
from tests.bundles import make_ordinary

FILES = {"model.onnx": b"a model", "error.onnx": b"a model for its error"}
SHA256 = {name: hashlib.sha256(content).hexdigest() for name, content in FILES.items()}
WIDTH = len(PAPER_TABLE)
CONFORMAL = Conformal(coverage_frac=0.9, quantile=2.0, doubtful_above_ratio=0.15)


def model(table: FeatureTable = PAPER_TABLE) -> ModelManifest:
    width = len(table)
    return ModelManifest(
        table_digest=table.digest,
        feature_names=table.names,
        model_file="model.onnx",
        error_model_file="error.onnx",
        mu_range=(0.16, 0.7),
        envelope=Envelope(lower=(0.0,) * width, upper=(1.0,) * width, outside_allowed_count=3),
        golden=GoldenVectors(rows=((0.5,) * width, (0.1,) * width), mu=(0.3, 0.4), expected_error_ratio=(0.05, 0.06)),
        conformal=CONFORMAL,
        ordinary=make_ordinary(),
    )


def bundle_of(*models: ModelManifest, files: dict[str, str] = SHA256) -> BundleManifest:
    return BundleManifest(
        name="test",
        bundle_id=bundle_id_of(models, files),
        models=models,
        metrics={"mape_frac": 0.05},
        provenance={"command": "test"},
        files_sha256=dict(files),
    )


def manifest() -> BundleManifest:
    return bundle_of(model())


def reference(
    section_id: str | None = None,
    *,
    width: int = WIDTH,
    rows_count: int = 300,
    mu_quantiles: tuple[float, ...] = (0.2, 0.4, 0.7),
) -> TrainingReference:
    return TrainingReference(section_id, rows_count, ((0.0, 0.5, 1.0),) * width, mu_quantiles)


def with_driving(**change) -> OrdinaryDriving:
    ordinary = make_ordinary()
    return dataclasses.replace(ordinary, driving=dataclasses.replace(ordinary.driving, **change))


def changed(**change) -> BundleManifest:
    return bundle_of(dataclasses.replace(model(), **change))


def test_a_manifest_survives_the_way_through_json():
    assert manifest_from_json(manifest_to_json(manifest())) == manifest()


def test_references_and_models_for_single_sections_survive_too():
    local = dataclasses.replace(
        model(), section_id="bend", model_file="local.onnx", error_model_file="local-error.onnx"
    )
    files = {**SHA256, "local.onnx": "a" * 64, "local-error.onnx": "b" * 64}
    both = bundle_of(dataclasses.replace(model(), references=(reference(), reference("bend"))), local, files=files)
    assert manifest_from_json(manifest_to_json(both)) == both


def test_a_section_is_served_by_its_own_model_and_any_other_by_the_global_one():
    local = dataclasses.replace(model(), section_id="bend", model_file="local.onnx")
    both = bundle_of(model(), local)
    assert both.model_for(PAPER_TABLE.digest, section_id="bend") == local
    assert both.model_for(PAPER_TABLE.digest, section_id="loop") == model()
    assert both.model_for(PAPER_TABLE.digest) == model()
    assert both.table_digests == (PAPER_TABLE.digest,)


def test_a_road_is_held_against_its_own_training_and_any_other_against_that_on_all_roads():
    known = dataclasses.replace(model(), references=(reference("bend"), reference()))
    assert known.reference_for("bend") == reference("bend")
    assert known.reference_for("loop") == reference()
    assert model().reference_for("bend") is None


def test_another_envelope_makes_another_bundle_and_another_name_does_not():
    wider = changed(envelope=Envelope(lower=(-1.0,) * WIDTH, upper=(1.0,) * WIDTH, outside_allowed_count=3))
    assert wider.bundle_id != manifest().bundle_id
    renamed = dataclasses.replace(manifest(), name="other", provenance={}, metrics={})
    assert bundle_id_of(renamed.models, renamed.files_sha256) == manifest().bundle_id


def test_numbers_that_a_manifest_would_cut_are_refused():
    precise = changed(ordinary=with_driving(whitening_ratio=(((1.0, 0.0), (-5.0, 0.1)),)))
    with pytest.raises(BundleError, match="32 bits"):
        manifest_to_json(precise)


def test_a_list_of_numbers_stands_on_one_line():
    assert '"mu_range": [0.16, 0.7]' in manifest_to_json(manifest())


def test_a_model_without_an_expected_error_survives_too():
    golden = dataclasses.replace(model().golden, expected_error_ratio=None)
    plain = changed(error_model_file=None, conformal=None, golden=golden)
    assert manifest_from_json(manifest_to_json(plain)) == plain


def test_a_model_that_leaves_it_to_the_envelope_survives_too():
    plain = changed(ordinary=None)
    assert manifest_from_json(manifest_to_json(plain)) == plain


def test_a_bundle_serves_several_tables_with_a_model_each(wider_table):
    newer = dataclasses.replace(model(wider_table), model_file="newer.onnx", error_model_file="newer-error.onnx")
    both = bundle_of(newer, model(), files={**SHA256, "newer.onnx": "a" * 64, "newer-error.onnx": "b" * 64})
    assert manifest_from_json(manifest_to_json(both)) == both
    assert both.table_digests == (wider_table.digest, PAPER_TABLE.digest)
    assert both.model_for(PAPER_TABLE.digest) == model()
    assert both.model_for(wider_table.digest) == newer
    assert both.model_for("0" * 16) is None


def test_the_id_names_every_model_in_its_order():
    files = {name: hashlib.sha256(name.encode()).hexdigest() for name in "abcd"}
    one, other = (
        dataclasses.replace(model(), model_file=first, error_model_file=second) for first, second in ("ab", "cd")
    )
    ids = {
        bundle_id_of(models, files)
        for models in ((one,), (other,), (one, other), (other, one), (dataclasses.replace(one, error_model_file=None),))
    }
    assert len(ids) == 5
    assert bundle_id_of((one,), {**files, "b": "f" * 64}) not in ids
    assert all(len(bundle_id) == 16 for bundle_id in ids)


def test_a_bundle_for_a_table_not_spoken_here_is_refused():
    with pytest.raises(FeatureTableError, match="0000000000000000"):
        manifest_from_json(manifest_to_json(changed(table_digest="0" * 16)))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"feature_names": PAPER_TABLE.names[::-1]}, "feature names"),
        ({"model_file": "other.onnx"}, "no digest"),
        ({"error_model_file": "other.onnx"}, "no digest"),
        ({"error_model_file": "model.onnx"}, "share a file"),
        ({"envelope": Envelope((0.0,) * 77, (1.0,) * WIDTH, 3)}, "width"),
        ({"ordinary": dataclasses.replace(make_ordinary(), road_columns=("no_such_m",))}, "ordinary driving"),
        ({"ordinary": dataclasses.replace(make_ordinary(), road_columns=())}, "ordinary driving"),
        ({"ordinary": with_driving(columns=("no_such_m", "steer_mean_rad"))}, "ordinary driving"),
        ({"ordinary": with_driving(limit_level=float("nan"))}, "ordinary driving"),
        ({"golden": GoldenVectors(((0.5,) * WIDTH,), (0.3, 0.4), (0.1,))}, "golden"),
        ({"golden": GoldenVectors(((0.5,) * WIDTH,), (0.3,), (0.1, 0.2))}, "golden"),
        ({"golden": GoldenVectors(((0.5,) * 77,), (0.3,), (0.1,))}, "golden"),
        ({"golden": GoldenVectors((), (), ())}, "golden"),
        ({"mu_range": (0.7, 0.16)}, "range is empty"),
        ({"error_model_file": None}, "expected error needs"),
        ({"conformal": None}, "expected error needs"),
        ({"golden": GoldenVectors(((0.5,) * WIDTH,), (0.3,))}, "expected error needs"),
        ({"conformal": Conformal(1.0, 2.0, 0.1)}, "means nothing"),
        ({"conformal": Conformal(0.9, 0.0, 0.1)}, "means nothing"),
        ({"conformal": Conformal(0.9, float("nan"), 0.1)}, "means nothing"),
        ({"conformal": Conformal(0.9, 2.0, float("inf"))}, "means nothing"),
        ({"references": (reference(width=77),)}, "reference does not fit"),
        ({"references": (reference(mu_quantiles=(0.1, 0.2)),)}, "reference does not fit"),
        ({"references": (reference(mu_quantiles=(0.2, 0.1, 0.3)),)}, "reference does not fit"),
        ({"references": (reference(rows_count=0),)}, "reference does not fit"),
        ({"references": (reference(), reference())}, "of one road"),
    ],
)
def test_a_model_that_contradicts_itself_is_refused(change, told):
    with pytest.raises(BundleError, match=told):
        manifest_from_json(manifest_to_json(changed(**change)))


@pytest.mark.parametrize(
    ("broken", "told"),
    [
        (dataclasses.replace(bundle_of(model()), bundle_id="f" * 16), "not its models'"),
        (bundle_of(), "no model"),
        (bundle_of(model(), dataclasses.replace(model(), model_file="x", error_model_file=None)), "one feature table"),
        (bundle_of(dataclasses.replace(model(), section_id="bend")), "no global model"),
    ],
)
def test_a_bundle_that_contradicts_itself_is_refused(broken, told):
    with pytest.raises(BundleError, match=told):
        manifest_from_json(manifest_to_json(broken))


@given(st.floats(0.05, 1.5), st.floats(1e-4, 1.0), st.floats(0.1, 10.0))
def test_the_bounds_lie_evenly_about_the_estimate_on_the_logarithm(mu, error_ratio, quantile):
    conformal = Conformal(0.9, quantile, 0.2)
    low, high = (f(mu, expected_error_ratio=error_ratio) for f in (conformal.mu_low, conformal.mu_high))
    assert low < mu < high
    assert log(mu / low) == pytest.approx(quantile * error_ratio)
    assert log(high / mu) == pytest.approx(quantile * error_ratio)


def test_a_large_expected_error_says_no_more_than_at_least():
    assert not CONFORMAL.at_least(expected_error_ratio=0.15)
    assert CONFORMAL.at_least(expected_error_ratio=0.1501)


def test_a_manifest_of_another_format_is_refused():
    raw = json.loads(manifest_to_json(manifest()))
    raw["format_version"] = 99
    with pytest.raises(BundleError, match="format 99"):
        manifest_from_json(json.dumps(raw))


MANGLED: list[object] = [None, 7, [], {}, "x", [[[]]]]


@pytest.mark.parametrize("key", [f.name for f in dataclasses.fields(BundleManifest)])
@pytest.mark.parametrize("value", MANGLED)
def test_a_mangled_manifest_is_refused_and_never_crashes(key, value):
    raw = json.loads(manifest_to_json(manifest()))
    raw[key] = value
    harmless = {("name", "x"), ("metrics", "{}"), ("provenance", "{}")}
    if key == "name" or (key, str(value)) in harmless:
        manifest_from_json(json.dumps(raw))
    else:
        with pytest.raises((BundleError, FeatureTableError)):
            manifest_from_json(json.dumps(raw))
    del raw[key]
    with pytest.raises(BundleError, match=key):
        manifest_from_json(json.dumps(raw))


@pytest.mark.parametrize("key", [f.name for f in dataclasses.fields(ModelManifest)])
@pytest.mark.parametrize("value", MANGLED)
def test_a_mangled_model_is_refused_and_never_crashes(key, value):
    raw = json.loads(manifest_to_json(manifest()))
    raw["models"][0][key] = value
    if (key, value) in [("section_id", None), ("references", []), ("references", {})]:
        assert manifest_from_json(json.dumps(raw)) == manifest()
    else:
        with pytest.raises((BundleError, FeatureTableError)):
            manifest_from_json(json.dumps(raw))
    del raw["models"][0][key]
    with pytest.raises(BundleError, match=key):
        manifest_from_json(json.dumps(raw))


@pytest.mark.parametrize("key", [f.name for f in dataclasses.fields(DrivingEnvelope)])
@pytest.mark.parametrize("value", MANGLED)
def test_mangled_ordinary_driving_is_refused_and_never_crashes(key, value):
    raw = json.loads(manifest_to_json(manifest()))
    driving = raw["models"][0]["ordinary"]["driving"]
    driving[key] = value
    with pytest.raises(BundleError):
        manifest_from_json(json.dumps(raw))
    del driving[key]
    with pytest.raises(BundleError, match=key):
        manifest_from_json(json.dumps(raw))


@pytest.mark.parametrize("text", ["", "[]", "7", "null", "{", '{"format_version": 1}', '{"format_version": 2}'])
def test_what_is_no_manifest_is_a_bundle_error(text):
    with pytest.raises(BundleError):
        manifest_from_json(text)


def test_files_must_be_the_ones_named_byte_for_byte():
    check_files(manifest(), FILES)
    with pytest.raises(BundleError, match="differs"):
        check_files(manifest(), {**FILES, "error.onnx": b"!"})
    with pytest.raises(BundleError, match="holds"):
        check_files(manifest(), {})
    with pytest.raises(BundleError, match="extra"):
        check_files(manifest(), {**FILES, "extra": b""})
