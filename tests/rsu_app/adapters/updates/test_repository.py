"""What a unit takes from a repository that is whole, and what it refuses whoever signed it."""

import shutil
import time

import pytest

from roadgrip.release import bundle_target, ring_target
from rsu_app.rollout_ports import FetchedRelease, UpdateReason
from rsu_app.usecases.readiness import EARLIEST_SANE_UNIX_S
from tests.bundles import MODEL_NAME
from tests.repositories import EXPIRED, ROLES, SignedRepository
from tests.rsu_app.adapters.updates.sites import UpdateSite, content_of

DAY_S = 86_400.0


# What is news --------------------------------------------------------------------------------------------------------


def test_a_release_comes_with_its_files(site):
    release = site.repository.release(site.bundle(), sequence_number=3)
    (site.shelf.incoming_folder / "of an earlier visit").mkdir(parents=True)
    assert site.fetch() == FetchedRelease(release, site.shelf.incoming_folder)
    assert content_of(site.shelf.incoming_folder) == content_of(site.bundle())
    assert site.shelf.folder_of(site.shelf.put(release, site.shelf.incoming_folder))


def test_a_release_that_is_known_is_no_news(running):
    assert running.fetch(newer_than=1) is None
    assert not running.shelf.incoming_folder.exists()
    assert running.runs_on()


def test_each_ring_has_its_own_release(site):
    site.repository.release(site.bundle(0.5), sequence_number=1, ring="all")
    site.repository.release(site.bundle(0.6), sequence_number=2, ring="canary")
    for ring, number, bundle in (("all", 1, site.bundle(0.5)), ("canary", 2, site.bundle(0.6))):
        fetched = site.fetch(ring=ring)
        assert isinstance(fetched, FetchedRelease)
        assert fetched.release.sequence_number == number
        assert content_of(site.shelf.incoming_folder) == content_of(bundle)


def test_a_folder_can_be_named_by_its_file_address(site):
    folder = site.folder / "a stick"
    site.repository.release(site.bundle(), sequence_number=1)
    site.repository.folder.rename(folder)
    assert isinstance(site.fetch(site.source(folder.as_uri())), FetchedRelease)


def test_digests_in_timestamp_and_snapshot_are_fine(tmp_path):
    site = UpdateSite(tmp_path, SignedRepository(tmp_path / "repository", with_hashes=True))
    site.run_first_release()
    site.repository.release(site.bundle(0.6), sequence_number=2)
    assert site.fetched(newer_than=1).release.sequence_number == 2


def test_a_step_back_on_purpose_is_a_new_release(running):
    running.repository.release(running.bundle(0.6), sequence_number=2)
    running.repository.release(running.bundle(0.5), sequence_number=3)
    assert running.fetched(newer_than=1).release.sequence_number == 3


# Clocks and dates ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unix_s", [0.0, 1_000.0, EARLIEST_SANE_UNIX_S - 1.0, float("nan")])
def test_a_clock_that_cannot_be_right_refuses_everything(running, unix_s):
    running.repository.release(running.bundle(0.6), sequence_number=2)
    assert running.reason(running.source(unix_s=lambda: unix_s), newer_than=1) is UpdateReason.CLOCK
    assert running.runs_on()


def test_a_clock_behind_what_the_unit_has_proof_of_refuses_everything(running):
    running.repository.release(running.bundle(0.6), sequence_number=2)
    known_unix_s = time.time() + 400.0 * DAY_S
    late = running.source(unix_s=lambda: known_unix_s - 1.01 * DAY_S, not_before_unix_s=known_unix_s)
    assert running.reason(late, newer_than=1) is UpdateReason.CLOCK
    assert running.runs_on()
    right = running.source(unix_s=lambda: known_unix_s - 0.99 * DAY_S, not_before_unix_s=known_unix_s)
    assert running.fetched(right, newer_than=1).release.sequence_number == 2


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("with_hashes", [False, True])
def test_metadata_that_has_expired_is_refused_until_it_is_signed_anew(tmp_path, role, with_hashes):
    site = UpdateSite(tmp_path, SignedRepository(tmp_path / "repository", with_hashes=with_hashes))
    site.run_first_release()
    site.repository.expires[role] = EXPIRED
    site.repository.release(site.bundle(0.6), sequence_number=2, publish=False)
    site.repository.rotate()  # A new root of the same keys: the root's date goes with it.
    assert site.reason(newer_than=1) is UpdateReason.EXPIRED
    # What is cached by now has expired itself.
    assert site.reason(newer_than=1) is UpdateReason.EXPIRED
    assert site.runs_on()
    del site.repository.expires[role]
    site.repository.rotate()
    assert site.fetched(newer_than=1).release.sequence_number == 2


def test_a_repository_nobody_signs_anew_is_refused_when_it_has_expired(tmp_path):
    # A mirror that stands still would otherwise hold back every release, unnoticed.
    repository = SignedRepository(tmp_path / "repository", expires={"timestamp": EXPIRED})
    site = UpdateSite(tmp_path, repository)
    repository.release(site.bundle(), sequence_number=1)
    assert site.reason() is UpdateReason.EXPIRED
    assert "timestamp" in site.refusal().detail


# Who signed ----------------------------------------------------------------------------------------------------------


def test_a_repository_of_somebody_else_is_refused(running):
    foreign = SignedRepository(running.folder / "foreign")
    foreign.release(running.bundle(0.6), sequence_number=2)
    assert running.reason(running.source(str(foreign.folder)), newer_than=1) is UpdateReason.BAD_SIGNATURE
    assert running.runs_on()


def test_a_root_of_somebody_else_is_refused(running):
    foreign = SignedRepository(running.folder / "foreign")
    foreign.release(running.bundle(0.6), sequence_number=2)
    foreign.rotate("root")
    assert running.reason(running.source(str(foreign.folder)), newer_than=1) is UpdateReason.BAD_SIGNATURE
    assert running.runs_on()


@pytest.mark.parametrize("role", ["targets", "snapshot", "timestamp"])
def test_one_signature_of_two_is_not_enough(tmp_path, role):
    site = UpdateSite(tmp_path, SignedRepository(tmp_path / "repository", thresholds={"root": 2, role: 2}))
    site.run_first_release()
    site.repository.release(site.bundle(0.6), sequence_number=2, publish=False)
    site.repository.publish(signatures={role: 1})
    assert site.reason(newer_than=1) is UpdateReason.BAD_SIGNATURE
    assert site.runs_on()
    site.repository.publish()
    assert site.fetched(newer_than=1).release.sequence_number == 2


@pytest.mark.parametrize("roles", [["root"], ["targets"], ["timestamp", "snapshot"], list(ROLES)])
def test_a_unit_that_slept_follows_every_change_of_keys(tmp_path, roles):
    site = UpdateSite(tmp_path, SignedRepository(tmp_path / "repository", thresholds={"root": 2, "targets": 2}))
    site.run_first_release()
    for _ in range(4):
        site.repository.rotate(*roles)
    site.repository.release(site.bundle(0.6), sequence_number=2)
    assert site.fetched(newer_than=1).release.sequence_number == 2


def test_a_key_that_was_taken_away_signs_no_more(running):
    old = running.folder / "old"
    shutil.copytree(running.repository.folder, old)
    running.repository.rotate("targets", "snapshot", "timestamp")
    assert running.fetch(newer_than=1) is None
    shutil.copy(running.repository.metadata_folder / "2.root.json", old / "metadata")
    assert running.reason(running.source(str(old)), newer_than=1) is UpdateReason.BAD_SIGNATURE
    assert running.runs_on()


def test_a_chain_of_roots_with_a_gap_is_refused(running):
    running.repository.rotate(*ROLES)
    running.repository.rotate(*ROLES)
    (running.repository.metadata_folder / "2.root.json").unlink()
    assert running.reason(newer_than=1) is UpdateReason.BAD_SIGNATURE
    assert running.runs_on()


def test_a_root_in_the_place_of_another_is_refused(running):
    running.repository.rotate()
    running.repository.rotate()
    folder = running.repository.metadata_folder
    shutil.copy(folder / "3.root.json", folder / "2.root.json")
    assert running.reason(newer_than=1) is UpdateReason.TAMPERED
    assert running.runs_on()


# What is older -------------------------------------------------------------------------------------------------------


def test_an_older_copy_of_the_repository_is_refused(running):
    running.repository.publish()
    old = running.folder / "old"
    shutil.copytree(running.repository.folder, old)
    running.repository.release(running.bundle(0.6), sequence_number=2)
    assert running.fetched(newer_than=1).release.sequence_number == 2
    assert running.reason(running.source(str(old)), newer_than=1) is UpdateReason.DOWNGRADE
    assert running.runs_on()


def test_a_snapshot_that_takes_targets_back_is_refused(running):
    # Such a repository was restored from a backup, or its online keys were stolen.
    repository = running.repository
    repository.publish()
    assert running.fetch(newer_than=1) is None
    repository.publish_older_targets()
    assert running.reason(newer_than=1) is UpdateReason.DOWNGRADE
    assert running.runs_on()


def test_a_ring_that_goes_back_is_refused(running):
    running.repository.release(running.bundle(0.6), sequence_number=1)
    refusal = running.refusal(newer_than=2)
    assert refusal.reason is UpdateReason.DOWNGRADE
    assert "release 1" in refusal.detail
    assert "release 2" in refusal.detail
    assert running.runs_on()


# What does not belong together ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["snapshot", "targets"])
@pytest.mark.parametrize("with_hashes", [False, True])
def test_metadata_of_another_day_in_the_place_of_todays_is_refused(tmp_path, name, with_hashes):
    site = UpdateSite(tmp_path, SignedRepository(tmp_path / "repository", with_hashes=with_hashes))
    site.run_first_release()
    before = site.repository.version
    site.repository.release(site.bundle(0.6), sequence_number=2)
    folder = site.repository.metadata_folder
    shutil.copy(folder / f"{before}.{name}.json", folder / f"{site.repository.version}.{name}.json")
    assert site.reason(newer_than=1) is UpdateReason.TAMPERED
    assert site.runs_on()


def test_a_file_of_another_bundle_in_the_place_of_this_ones_is_refused(running):
    repository = running.repository
    first = repository.release(running.bundle(0.5), sequence_number=2)
    second = repository.release(running.bundle(0.6), sequence_number=3)
    places = [repository.place_of(bundle_target(each.bundle_id, MODEL_NAME)) for each in (first, second)]
    shutil.copy(*places)
    assert running.reason(newer_than=1) is UpdateReason.TAMPERED
    assert running.runs_on()


def test_a_signed_file_that_is_not_the_releases_is_refused(running):
    release = running.repository.release(running.bundle(0.6), sequence_number=2, publish=False)
    running.repository.add(bundle_target(release.bundle_id, MODEL_NAME), b"another model")
    running.repository.publish()
    refusal = running.refusal(newer_than=1)
    assert refusal.reason is UpdateReason.TAMPERED
    assert MODEL_NAME in refusal.detail
    assert running.runs_on()


def test_the_pointer_of_another_ring_in_the_place_of_the_units_is_refused(running):
    repository = running.repository
    repository.release(running.bundle(0.5), sequence_number=2, ring="all")
    repository.release(running.bundle(0.6), sequence_number=3, ring="canary")
    shutil.copy(repository.place_of(ring_target("all")), repository.place_of(ring_target("canary")))
    assert running.reason(newer_than=1) is UpdateReason.TAMPERED
    assert running.runs_on()


def test_a_signed_pointer_that_says_another_ring_is_refused(running):
    release = running.repository.release(running.bundle(0.6), sequence_number=2, ring="all")
    running.repository.point(release, at_ring="canary")
    refusal = running.refusal(newer_than=1)
    assert refusal.reason is UpdateReason.TAMPERED
    assert "ring all" in refusal.detail
    assert running.runs_on()
