from __future__ import annotations

import json
from dataclasses import fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.release import Release, ReleaseError, bundle_target, release_from_json, release_to_json, ring_target

RELEASE = Release(
    ring="canary",
    sequence_number=7,
    bundle_id="0123456789abcdef",
    files_sha256={"manifest.json": "a" * 64, "friction-v2.onnx": "b" * 64},
    released_unix_s=1_767_268_800,
    released_by="ann",
    reason="ground truth of the winter",
    gate="passed",
    ledger_hash="c" * 64,
)


def test_a_release_survives_the_way_through_json():
    assert release_from_json(release_to_json(RELEASE)) == RELEASE


@pytest.mark.parametrize(
    "change",
    [
        {"ring": ""},
        {"ring": "../all"},
        {"ring": "All"},
        {"sequence_number": 0},
        {"bundle_id": "0123"},
        {"bundle_id": "../../../../etc/x"},
        {"files_sha256": {}},
        {"files_sha256": {"../manifest.json": "a" * 64}},
        {"files_sha256": {".hidden": "a" * 64}},
        {"files_sha256": {"manifest.json": "a" * 63}},
        {"gate": "perhaps"},
    ],
)
def test_what_no_release_says_is_refused(change):
    with pytest.raises(ReleaseError):
        replace(RELEASE, **change)


@pytest.mark.parametrize("key", [field.name for field in fields(Release)])
@pytest.mark.parametrize("value", [None, [], {}, 1.5, "x"])
def test_a_mangled_release_is_refused_or_a_release_and_never_crashes(key, value):
    raw = json.loads(release_to_json(RELEASE))
    raw[key] = value
    try:
        release = release_from_json(json.dumps(raw))
    except ReleaseError:
        return
    assert isinstance(release, Release)


@given(st.text())
def test_what_is_no_release_is_said_so(text):
    with pytest.raises(ReleaseError):
        release_from_json(text)


def test_another_format_is_refused():
    raw = json.loads(release_to_json(RELEASE)) | {"format_version": 2}
    with pytest.raises(ReleaseError, match="format 2"):
        release_from_json(json.dumps(raw))


def test_targets_lie_where_both_sides_look_for_them():
    assert ring_target("canary") == "rings/canary.json"
    assert bundle_target("0123456789abcdef", "manifest.json") == "bundles/0123456789abcdef/manifest.json"
    with pytest.raises(ReleaseError):
        ring_target("../x")
