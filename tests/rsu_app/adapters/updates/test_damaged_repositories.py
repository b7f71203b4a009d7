"""Repositories that lack something, or whose files are not what was signed."""

import json
from dataclasses import replace

import pytest

from roadgrip.bundle import MANIFEST_NAME
from roadgrip.release import bundle_target, release_to_json, ring_target
from rsu_app.adapters.updates import FetchLimits
from rsu_app.rollout_ports import UpdateReason
from tests.bundles import MODEL_NAME

# Bytes that changed on the way ---------------------------------------------------------------------------------------


def flip(content):
    changed = bytearray(content)
    changed[len(changed) // 2] ^= 1
    return bytes(changed)


DAMAGES = {"one bit": flip, "truncated": lambda content: content[:-1], "longer": lambda content: content + b" "}


@pytest.mark.parametrize("name", [MODEL_NAME, MANIFEST_NAME, "pointer"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_file_that_was_changed_is_refused(running, name, damage):
    release = running.repository.release(running.bundle(0.6), sequence_number=2)
    path = running.repository.place_of(
        ring_target("canary") if name == "pointer" else bundle_target(release.bundle_id, name)
    )
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    assert running.reason(newer_than=1) is UpdateReason.TAMPERED
    assert running.runs_on()


@pytest.mark.parametrize("name", ["2.root.json", "timestamp.json", "{}.snapshot.json", "{}.targets.json"])
@pytest.mark.parametrize("place_frac", [0.02, 0.25, 0.5, 0.75, 0.98])
def test_one_bit_of_the_metadata_is_enough(running, name, place_frac):
    repository = running.repository
    repository.rotate()
    repository.release(running.bundle(0.6), sequence_number=2)
    path = repository.metadata_folder / name.format(repository.version)
    content = bytearray(path.read_bytes())
    content[int(place_frac * len(content))] ^= 4
    path.write_bytes(content)
    assert running.reason(newer_than=1) in {
        UpdateReason.BAD_SIGNATURE,
        UpdateReason.MALFORMED,
        UpdateReason.TAMPERED,
    }
    assert running.runs_on()


@pytest.mark.parametrize("content", [b"", b"{}", b"<html>Please log in</html>", b"\xff" * 100, b"[" * 10_000])
@pytest.mark.parametrize("name", ["2.root.json", "timestamp.json", "{}.snapshot.json", "{}.targets.json"])
def test_what_is_no_metadata_is_refused(running, name, content):
    running.repository.release(running.bundle(0.6), sequence_number=2)
    path = running.repository.metadata_folder / name.format(running.repository.version)
    path.write_bytes(content)
    assert running.reason(newer_than=1) is UpdateReason.MALFORMED
    assert running.runs_on()


def test_metadata_without_end_is_refused(running):
    with (running.repository.metadata_folder / "timestamp.json").open("ab") as file:
        file.truncate(100_000_000)
    assert running.reason(newer_than=1) is UpdateReason.TAMPERED
    assert running.runs_on()


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff", b"[" * 10_000, b'{"format_version": 2}'])
def test_a_signed_pointer_that_is_no_release_is_refused(running, content):
    running.repository.add(ring_target("canary"), content)
    running.repository.publish()
    assert running.reason(newer_than=1) is UpdateReason.MALFORMED
    assert running.runs_on()


def test_a_signed_pointer_without_end_is_refused(running):
    release = running.repository.release(running.bundle(0.6), sequence_number=2)
    long = replace(release, reason="because " * 10_000)
    running.repository.add(ring_target("canary"), release_to_json(long).encode())
    running.repository.publish()
    assert running.reason(newer_than=1) is UpdateReason.MALFORMED
    assert running.runs_on()


@pytest.mark.parametrize("missing", ["the manifest", "a target"])
def test_a_release_that_lacks_something_is_refused(running, missing):
    release = running.repository.release(running.bundle(0.6), sequence_number=2, publish=False)
    if missing == "the manifest":
        rest = {name: digest for name, digest in release.files_sha256.items() if name != MANIFEST_NAME}
        running.repository.point(replace(release, files_sha256=rest))
    else:
        del running.repository.targets.targets[bundle_target(release.bundle_id, MODEL_NAME)]
        running.repository.publish()
    assert running.reason(newer_than=1) is UpdateReason.MALFORMED
    assert running.runs_on()


@pytest.mark.parametrize("limits", [FetchLimits(bundle_bytes=1_000), FetchLimits(files_count=1)])
def test_a_bundle_beyond_the_units_budget_is_refused(running, limits):
    running.repository.release(running.bundle(0.6), sequence_number=2)
    refusal = running.refusal(running.source(limits=limits), newer_than=1)
    assert refusal.reason is UpdateReason.UNUSABLE_BUNDLE
    assert "this unit takes" in refusal.detail
    assert running.runs_on()


# What is not there ---------------------------------------------------------------------------------------------------


def test_a_ring_without_a_release_is_told_of(running):
    assert running.reason(ring="all", newer_than=1) is UpdateReason.NO_RELEASE
    assert running.runs_on()


def test_a_ring_that_can_have_no_release_is_told_of(running):
    assert running.reason(ring="Everyone!", newer_than=1) is UpdateReason.NOT_CONFIGURED
    assert running.runs_on()


def test_a_folder_that_is_not_there_is_told_of(running):
    refusal = running.refusal(running.source(str(running.folder / "not plugged in")), newer_than=1)
    assert refusal.reason is UpdateReason.UNREACHABLE
    assert "not plugged in" in refusal.detail
    assert running.runs_on()


@pytest.mark.parametrize("name", ["timestamp.json", "{}.snapshot.json", "{}.targets.json"])
def test_a_repository_that_lacks_metadata_is_told_of(running, name):
    running.repository.release(running.bundle(0.6), sequence_number=2)
    name = name.format(running.repository.version)
    (running.repository.metadata_folder / name).unlink()
    refusal = running.refusal(newer_than=1)
    assert refusal.reason is UpdateReason.UNREACHABLE
    assert name in refusal.detail
    assert running.runs_on()


def test_a_repository_that_lacks_a_file_of_the_bundle_is_told_of_and_half_a_bundle_is_not_kept(running):
    release = running.repository.release(running.bundle(0.6), sequence_number=2)
    running.repository.place_of(bundle_target(release.bundle_id, MODEL_NAME)).unlink()
    refusal = running.refusal(newer_than=1)
    assert refusal.reason is UpdateReason.UNREACHABLE
    assert MODEL_NAME in refusal.detail
    assert not running.shelf.incoming_folder.exists()
    assert running.runs_on()


@pytest.mark.parametrize("content", [None, b"", b"{}", b"no root"])
def test_a_trusted_root_that_is_missing_or_none_is_told_of(running, content):
    running.trusted_root.unlink()
    if content is not None:
        running.trusted_root.write_bytes(content)
    refusal = running.refusal(newer_than=1)
    assert refusal.reason is UpdateReason.NOT_CONFIGURED
    assert "trusted-root.json" in refusal.detail
    assert running.runs_on()


def test_a_trusted_root_that_nobody_signed_is_told_of(running):
    raw = json.loads(running.trusted_root.read_bytes())
    raw["signatures"] = []
    running.trusted_root.write_text(json.dumps(raw), encoding="utf-8")
    assert running.reason(newer_than=1) is UpdateReason.NOT_CONFIGURED
    assert running.runs_on()


@pytest.mark.parametrize(
    "address",
    ["", " ", "ftp://host/path", "http://", "http://host:port/", "https://user:password@host/", "file://host/path"],
)
def test_an_address_that_is_none_is_told_of_without_repeating_it(running, address):
    refusal = running.refusal(running.source(address or " "), newer_than=1)
    assert refusal.reason is UpdateReason.NOT_CONFIGURED
    assert "password" not in refusal.detail
    assert running.runs_on()
