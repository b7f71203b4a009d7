import errno
import hashlib
import os
import shutil
from dataclasses import replace

import pytest

from roadgrip.bundle import MANIFEST_NAME
from roadgrip.errors import BundleError, StoreError, StoreFullError
from rsu_app.adapters.updates import FolderShelf
from rsu_app.adapters.updates.shelf import STATE_LIMIT_BYTES
from rsu_app.adapters.updates.state_file import state_to_json
from rsu_app.domain.rollout import FACTORY, RolloutState, ShelvedBundle, confirmed, installed, rolled_back, switched
from tests.bundles import MODEL_NAME
from tests.repositories import make_small_bundle, release_of
from tests.rsu_app.adapters.updates.sites import content_of


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "above" / "shelf"


@pytest.fixture
def shelf(folder):
    return FolderShelf(folder)


def arrive(shelf, *, bias_mu=0.5, sequence_number=1):
    """Return a release whose files lie in the incoming folder."""
    shutil.rmtree(shelf.incoming_folder, ignore_errors=True)
    manifest = make_small_bundle(shelf.incoming_folder, bias_mu=bias_mu)
    return release_of(manifest.bundle_id, content_of(shelf.incoming_folder), sequence_number=sequence_number)


def put(shelf, *, bias_mu=0.5, sequence_number=1):
    return shelf.put(arrive(shelf, bias_mu=bias_mu, sequence_number=sequence_number), shelf.incoming_folder)


def live_state(bundle):
    return switched(installed(RolloutState(), bundle))


# The state -----------------------------------------------------------------------------------------------------------


def test_without_a_shelf_the_factorys_bundle_runs(shelf, folder):
    assert shelf.state() == RolloutState()
    assert shelf.notes == ()
    assert not folder.exists()


def test_a_state_is_kept(shelf, folder):
    state = live_state(put(shelf))
    shelf.keep_state(state)
    assert shelf.state() == FolderShelf(folder).state() == state


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\0" * 200,
        b"{}",
        b"\xff\xfe",
        b" " * (STATE_LIMIT_BYTES + 1) + state_to_json(RolloutState()).encode(),
        state_to_json(RolloutState()).encode()[:-20],
    ],
    ids=["empty", "zeros", "nothing in it", "no text", "too long", "cut"],
)
def test_a_damaged_state_is_moved_aside_and_told_of(shelf, folder, content):
    shelf.keep_state(RolloutState(newest_sequence_number=3))
    (folder / "state.json").write_bytes(content)
    (folder / "state.json.damaged").write_bytes(b"an older one")
    assert shelf.state() == RolloutState()
    assert "damaged" in shelf.notes[0]
    assert (folder / "state.json.damaged").read_bytes() == content
    assert FolderShelf(folder).state() == RolloutState()
    assert shelf.state() == RolloutState()
    assert shelf.notes == ()


def test_a_folder_in_the_states_place_is_moved_aside_and_told_of(shelf, folder):
    (folder / "state.json").mkdir(parents=True)
    (folder / "state.json.damaged" / "with something in it").mkdir(parents=True)
    assert shelf.state() == RolloutState()
    assert shelf.notes
    shelf.keep_state(RolloutState(newest_sequence_number=3))
    assert shelf.state().newest_sequence_number == 3


def test_a_damaged_state_that_cannot_be_moved_is_told_of_all_the_same(shelf, folder, monkeypatch):
    shelf.keep_state(RolloutState())
    (folder / "state.json").write_bytes(b"")
    monkeypatch.setattr("pathlib.Path.rename", failing(OSError(errno.EROFS, "Read-only file system")))
    assert shelf.state() == RolloutState()
    assert "Read-only file system" in shelf.notes[0]


def test_a_state_that_may_not_be_read_stays_where_it_is(shelf, folder, monkeypatch):
    shelf.keep_state(RolloutState(newest_sequence_number=3))
    with monkeypatch.context() as patched:
        # The rights themselves would not stop a test that runs as root.
        patched.setattr("pathlib.Path.open", failing(PermissionError(errno.EACCES, "Permission denied")))
        assert shelf.state() == RolloutState()
        assert "Permission denied" in shelf.notes[0]
    assert shelf.state().newest_sequence_number == 3


# Putting on the shelf ------------------------------------------------------------------------------------------------


def test_a_bundle_that_was_put_there_is_found_with_its_files(shelf):
    release = arrive(shelf, sequence_number=4)
    files = content_of(shelf.incoming_folder)
    bundle = shelf.put(release, shelf.incoming_folder)
    assert bundle == ShelvedBundle(
        release.bundle_id, release.files_sha256[MANIFEST_NAME], 4, release.ledger_hash, "passed"
    )
    assert content_of(shelf.folder_of(bundle)) == files
    assert not shelf.incoming_folder.exists()


def test_putting_changes_no_state(shelf):
    put(shelf)
    assert shelf.state() == RolloutState()


def test_a_bundle_that_is_there_and_whole_stays(shelf):
    first = put(shelf)
    inode = shelf.folder_of(first).stat().st_ino
    again = put(shelf, sequence_number=2)
    assert again == replace(first, sequence_number=2, ledger_hash=again.ledger_hash)
    assert shelf.folder_of(again).stat().st_ino == inode
    assert not shelf.incoming_folder.exists()


@pytest.mark.parametrize("damage", ["changed", "missing", "more", "a folder", "a file in its place"])
def test_a_bundle_that_is_there_and_damaged_is_replaced(shelf, folder, damage):
    bundle = put(shelf)
    place = shelf.folder_of(bundle)
    match damage:
        case "changed":
            (place / MODEL_NAME).write_bytes(b"another model")
        case "missing":
            (place / MODEL_NAME).unlink()
        case "more":
            (place / "more").write_bytes(b"")
        case "a folder":
            (place / "more").mkdir()
        case _:
            shutil.rmtree(place)
            place.write_bytes(b"")
    with pytest.raises(BundleError):
        shelf.folder_of(bundle)
    put(shelf)
    assert shelf.folder_of(bundle) == place
    assert sorted(path.name for path in folder.iterdir()) == ["bundles"]


@pytest.mark.parametrize("name", [MODEL_NAME, MANIFEST_NAME])
def test_files_that_are_not_the_releases_are_refused(shelf, name):
    release = arrive(shelf)
    path = shelf.incoming_folder / name
    path.write_bytes(path.read_bytes() + b" ")
    with pytest.raises(BundleError, match=name):
        shelf.put(release, shelf.incoming_folder)


def test_files_that_are_the_manifests_and_not_the_releases_are_refused(shelf):
    release = arrive(shelf)
    other = replace(release, files_sha256={**release.files_sha256, MODEL_NAME: "0" * 64})
    with pytest.raises(BundleError, match=MODEL_NAME):
        shelf.put(other, shelf.incoming_folder)


def test_files_the_release_does_not_name_are_refused(shelf):
    release = arrive(shelf)
    (shelf.incoming_folder / "more").write_bytes(b"")
    with pytest.raises(BundleError, match="more"):
        shelf.put(release, shelf.incoming_folder)


def test_a_release_that_names_another_bundle_than_its_files_are_is_refused(shelf):
    release = replace(arrive(shelf), bundle_id="0" * 16)
    with pytest.raises(BundleError, match="0000"):
        shelf.put(release, shelf.incoming_folder)


def test_a_release_whose_manifest_names_other_files_is_refused(shelf):
    arrive(shelf)
    (shelf.incoming_folder / "more").write_bytes(b"")
    files = content_of(shelf.incoming_folder)
    release = release_of(arrive(shelf).bundle_id, files)
    (shelf.incoming_folder / "more").write_bytes(b"")
    with pytest.raises(BundleError, match="its manifest names"):
        shelf.put(release, shelf.incoming_folder)


def test_a_release_without_a_manifest_is_refused(shelf):
    release = arrive(shelf)
    (shelf.incoming_folder / MANIFEST_NAME).unlink()
    release = release_of(release.bundle_id, content_of(shelf.incoming_folder))
    with pytest.raises(BundleError):
        shelf.put(release, shelf.incoming_folder)


def test_what_never_arrived_is_refused(shelf):
    release = arrive(shelf)
    shutil.rmtree(shelf.incoming_folder)
    with pytest.raises(BundleError, match="incoming"):
        shelf.put(release, shelf.incoming_folder)


def test_a_bundle_for_features_this_software_does_not_speak_is_refused(shelf):
    release = arrive(shelf)
    path = shelf.incoming_folder / MANIFEST_NAME
    raw = path.read_text(encoding="utf-8")
    digest = raw.split('"table_digest": "')[1].split('"')[0]
    path.write_text(raw.replace(digest, "0" * len(digest)), encoding="utf-8")
    with pytest.raises(BundleError):
        shelf.put(release_of(release.bundle_id, content_of(shelf.incoming_folder)), shelf.incoming_folder)


# Looking at it again -------------------------------------------------------------------------------------------------


def test_the_factorys_bundle_is_not_on_the_shelf(shelf):
    with pytest.raises(BundleError):
        shelf.folder_of(FACTORY)


def test_a_bundle_that_was_never_put_there_is_not_found(shelf):
    with pytest.raises(BundleError):
        shelf.folder_of(ShelvedBundle("a" * 16, "b" * 64, 1, "", "passed"))


@pytest.mark.parametrize("name", [MODEL_NAME, MANIFEST_NAME])
def test_one_bit_that_flips_is_found(shelf, name):
    bundle = put(shelf)
    path = shelf.folder_of(bundle) / name
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(BundleError, match=name):
        shelf.folder_of(bundle)


def test_a_manifest_and_files_of_another_bundle_are_found(shelf):
    first, second = put(shelf, bias_mu=0.5), put(shelf, bias_mu=0.6)
    shutil.copytree(shelf.folder_of(second), shelf.folder_of(first), dirs_exist_ok=True)
    with pytest.raises(BundleError, match=MANIFEST_NAME):
        shelf.folder_of(first)


# Clearing ------------------------------------------------------------------------------------------------------------


def test_clearing_keeps_what_a_state_needs_and_nothing_else(shelf, folder):
    bundles = [put(shelf, bias_mu=0.5 + 0.01 * number, sequence_number=number) for number in (1, 2, 3, 4)]
    state = RolloutState()
    for bundle in bundles[1:]:
        state = confirmed(switched(installed(state, bundle)))
    shelf.keep_state(state)
    (folder / "bundles" / "litter").write_bytes(b"")
    (folder / "discarded" / "half").mkdir(parents=True)
    (folder / "state.json.tmp").write_bytes(b"half a st")
    arrive(shelf)
    shelf.clear(state)
    assert sorted(path.name for path in folder.iterdir()) == ["bundles", "state.json"]
    kept = {path.name.split("-")[0] for path in (folder / "bundles").iterdir()}
    assert kept == state.needed_ids == {bundles[2].bundle_id, bundles[3].bundle_id}
    assert shelf.folder_of(bundles[3])
    assert shelf.folder_of(bundles[2])


def test_clearing_keeps_the_candidate(shelf):
    live, candidate = put(shelf), put(shelf, bias_mu=0.6, sequence_number=2)
    state = installed(confirmed(live_state(live)), candidate)
    shelf.clear(state)
    assert shelf.folder_of(live) != shelf.folder_of(candidate)


def test_after_a_step_back_the_bundle_that_failed_goes(shelf):
    live, failed = put(shelf), put(shelf, bias_mu=0.6, sequence_number=2)
    state = rolled_back(switched(installed(confirmed(live_state(live)), failed)))
    shelf.clear(state)
    assert shelf.folder_of(live)
    with pytest.raises(BundleError):
        shelf.folder_of(failed)


def test_of_two_bundles_with_one_id_only_the_one_that_is_needed_stays(shelf):
    # The id leaves out name and metrics, so the laboratory can publish a bundle anew with other words about it.
    old = put(shelf)
    release = arrive(shelf, sequence_number=2)
    path = shelf.incoming_folder / MANIFEST_NAME
    path.write_text(path.read_text(encoding="utf-8").replace('"linear"', '"linear, renamed"'), encoding="utf-8")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    new = shelf.put(
        replace(release, files_sha256={**release.files_sha256, MANIFEST_NAME: digest}), shelf.incoming_folder
    )
    assert new.bundle_id == old.bundle_id
    assert shelf.folder_of(old) != shelf.folder_of(new)
    shelf.clear(live_state(new))
    assert shelf.folder_of(new)
    with pytest.raises(BundleError):
        shelf.folder_of(old)


def test_clearing_where_there_is_nothing_does_nothing(shelf, folder):
    shelf.clear(RolloutState())
    assert not folder.exists()


def test_clearing_never_raises_for_the_disks_sake(shelf, monkeypatch):
    live, surplus = put(shelf), put(shelf, bias_mu=0.6, sequence_number=2)
    arrive(shelf)
    with monkeypatch.context() as patched:
        patched.setattr("shutil.rmtree", failing(OSError(errno.EIO, "Input/output error")))
        shelf.clear(live_state(live))
    assert shelf.folder_of(live)
    assert shelf.folder_of(surplus)


# A disk that cannot --------------------------------------------------------------------------------------------------


def failing(error):
    def fail(*_args, **_options):
        raise error

    return fail


@pytest.mark.parametrize(
    ("number", "raised"), [(errno.ENOSPC, StoreFullError), (errno.EDQUOT, StoreFullError), (errno.EIO, StoreError)]
)
def test_a_state_that_cannot_be_written_leaves_the_old_one(shelf, monkeypatch, number, raised):
    shelf.keep_state(RolloutState(newest_sequence_number=3))
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", failing(OSError(number, os.strerror(number))))
        with pytest.raises(raised) as caught:
            shelf.keep_state(RolloutState(newest_sequence_number=4))
    assert type(caught.value) is raised
    assert shelf.state().newest_sequence_number == 3


@pytest.mark.parametrize(
    ("number", "raised"), [(errno.ENOSPC, StoreFullError), (errno.EDQUOT, StoreFullError), (errno.EIO, StoreError)]
)
def test_a_bundle_that_cannot_be_written_is_told_of(shelf, monkeypatch, number, raised):
    release = arrive(shelf)
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", failing(OSError(number, os.strerror(number))))
        with pytest.raises(raised) as caught:
            shelf.put(release, shelf.incoming_folder)
    assert type(caught.value) is raised
    assert shelf.folder_of(shelf.put(release, shelf.incoming_folder))
