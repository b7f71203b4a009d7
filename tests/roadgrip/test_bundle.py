import dataclasses
import hashlib
import json

import pytest

from roadgrip.bundle import (
    BundleManifest,
    Envelope,
    GoldenVectors,
    check_files,
    manifest_from_json,
    manifest_to_json,
)
from roadgrip.errors import BundleError, FeatureTableError
from roadgrip.features import FEATURE_NAMES, TABLE_DIGEST

MODEL = b"a model"
SHA256 = hashlib.sha256(MODEL).hexdigest()
WIDTH = len(FEATURE_NAMES)


def manifest() -> BundleManifest:
    return BundleManifest(
        name="test",
        bundle_id=SHA256[:16],
        table_digest=TABLE_DIGEST,
        feature_names=FEATURE_NAMES,
        model_file="model.onnx",
        files_sha256={"model.onnx": SHA256},
        mu_range=(0.16, 0.7),
        envelope=Envelope(lower=(0.0,) * WIDTH, upper=(1.0,) * WIDTH, outside_allowed_count=3),
        golden=GoldenVectors(rows=((0.5,) * WIDTH, (0.1,) * WIDTH), mu=(0.3, 0.4)),
        metrics={"mape_frac": 0.05},
        provenance={"command": "test"},
    )


def test_a_manifest_survives_the_way_through_json():
    assert manifest_from_json(manifest_to_json(manifest())) == manifest()


def test_a_bundle_for_another_feature_table_is_refused():
    text = manifest_to_json(dataclasses.replace(manifest(), table_digest="0" * 16))
    with pytest.raises(FeatureTableError, match="0000000000000000"):
        manifest_from_json(text)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"feature_names": FEATURE_NAMES[::-1]}, "feature names"),
        ({"model_file": "other.onnx"}, "no digest"),
        ({"envelope": Envelope((0.0,) * 77, (1.0,) * WIDTH, 3)}, "width"),
        ({"golden": GoldenVectors(((0.5,) * WIDTH,), (0.3, 0.4))}, "golden"),
        ({"golden": GoldenVectors(((0.5,) * 77,), (0.3,))}, "golden"),
        ({"golden": GoldenVectors((), ())}, "golden"),
        ({"mu_range": (0.7, 0.16)}, "range is empty"),
        ({"bundle_id": "f" * 16}, "not the model's"),
    ],
)
def test_a_manifest_that_contradicts_itself_is_refused(change, told):
    with pytest.raises(BundleError, match=told):
        manifest_from_json(manifest_to_json(dataclasses.replace(manifest(), **change)))


def test_a_manifest_of_another_format_is_refused():
    raw = json.loads(manifest_to_json(manifest()))
    raw["format_version"] = 99
    with pytest.raises(BundleError, match="format 99"):
        manifest_from_json(json.dumps(raw))


@pytest.mark.parametrize("key", [f.name for f in dataclasses.fields(BundleManifest)])
@pytest.mark.parametrize("value", [None, 7, [], {}, "x", [[[]]]])
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


@pytest.mark.parametrize("text", ["", "[]", "7", "null", "{", '{"format_version": 1}'])
def test_what_is_no_manifest_is_a_bundle_error(text):
    with pytest.raises(BundleError):
        manifest_from_json(text)


def test_files_must_be_the_ones_named_byte_for_byte():
    check_files(manifest(), {"model.onnx": MODEL})
    with pytest.raises(BundleError, match="differs"):
        check_files(manifest(), {"model.onnx": MODEL + b"!"})
    with pytest.raises(BundleError, match="holds"):
        check_files(manifest(), {})
    with pytest.raises(BundleError, match="extra"):
        check_files(manifest(), {"model.onnx": MODEL, "extra": b""})
