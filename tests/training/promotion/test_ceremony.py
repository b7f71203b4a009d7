"""Keys are made, come, go and are lost, and units follow or are told that they cannot."""

from __future__ import annotations

import stat

import pytest

from roadgrip.ledger import Action, chain_problems
from tests.training.promotion.laboratories import BY, DAY_S, NOW_UNIX_S, Site, bundle_id, make_site
from training.laboratory import Laboratory
from training.promotion.ceremony import RoleKeys, begin_repository, renew, rotate
from training.promotion.change import refresh as refresh_repository
from training.promotion.change import sign as sign_change
from training.promotion.change import staged_change, withdraw
from training.promotion.keys import KeysError, SigningKeys, make_key, read_key, read_password
from training.promotion.repository import RepositoryFolderError


@pytest.fixture
def site(tmp_path):
    return make_site(tmp_path)


def rotated(site: Site, *roles: str, keys: SigningKeys | None = None, **asked):
    return rotate(
        site.lab,
        roles,
        keys or site.keys(),
        **{"by": BY, "reason": "a test", "now_unix_s": NOW_UNIX_S + 1.0, **asked},
    )


def test_a_new_repository_is_good_and_holds_nothing(site):
    seen = site.seen_by_units()
    assert (seen.problems, dict(seen.releases)) == ((), {})


def test_key_files_are_for_their_owner_only(tmp_path):
    path, _ = make_key(tmp_path / "keys", "root", password=None)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert path.read_bytes().startswith(b"-----BEGIN PRIVATE KEY-----")


def test_a_key_file_reads_back_to_the_same_key(tmp_path):
    path, signer = make_key(tmp_path, "root", password=b"snow")
    assert b"ENCRYPTED" in path.read_bytes()
    read = read_key(path, passwords=(b"ice", b"snow"))
    assert read.public_key == signer.public_key
    read.public_key.verify_signature(read.sign(b"text"), b"text")


def test_a_wrong_password_is_told_with_the_file(tmp_path):
    path, _ = make_key(tmp_path, "root", password=b"snow")
    with pytest.raises(KeysError, match=r"root-1\.pem: the password is wrong"):
        read_key(path, passwords=(b"ice",))
    with pytest.raises(KeysError, match="give --password-file"):
        read_key(path)


def test_what_is_no_key_is_told_with_the_file(tmp_path):
    (tmp_path / "root-1.pem").write_text("nothing")
    with pytest.raises(KeysError, match=r"root-1\.pem is no key"):
        SigningKeys((tmp_path,)).of_role("root")


def test_a_folder_of_keys_that_is_not_there_is_told(tmp_path):
    with pytest.raises(KeysError, match="no folder of keys"):
        SigningKeys((tmp_path / "missing",)).of_role("root")


def test_only_the_first_line_of_a_password_file_counts(tmp_path):
    (tmp_path / "password").write_bytes(b"snow and ice\r\nnot this\n")
    assert read_password(tmp_path / "password") == b"snow and ice"
    (tmp_path / "password").write_bytes(b"\nnot this\n")
    with pytest.raises(KeysError, match="no password"):
        read_password(tmp_path / "password")


def test_a_repository_is_not_begun_over_another_one(site, tmp_path):
    before = site.snapshot_of_folder()
    with pytest.raises(RepositoryFolderError, match="there is a repository"):
        begin_repository(site.lab, tmp_path / "other-keys", by=BY, now_unix_s=NOW_UNIX_S)
    assert site.snapshot_of_folder() == before
    assert not (tmp_path / "other-keys").exists()


def test_keys_are_not_made_beside_others(site, tmp_path):
    with pytest.raises(KeysError, match="choose an empty folder"):
        begin_repository(Laboratory(tmp_path / "second"), site.keys("root-1").folders[0], by=BY, now_unix_s=NOW_UNIX_S)


def test_a_threshold_that_no_keys_can_meet_is_refused_before_keys_are_made(tmp_path):
    with pytest.raises(KeysError, match="3 of 2 keys"):
        make_site(tmp_path, root=RoleKeys(2, 3))
    assert not (tmp_path / "all-keys").exists()


def test_every_ceremony_is_in_the_ledger(site):
    rotated(site, "timestamp", revoked=["all"])
    renew(site.lab, site.keys(), by=BY, reason="yearly", now_unix_s=NOW_UNIX_S + 2.0)
    entries = site.lab.ledger()
    assert [(entry.action, entry.reason, entry.evidence["root_version"]) for entry in entries] == [
        (Action.KEYS_CHANGED, "repository begun", "1"),
        (Action.KEYS_CHANGED, "a test", "2"),
        (Action.KEYS_CHANGED, "yearly", "3"),
    ]
    assert chain_problems(entries) == []


@pytest.mark.parametrize("role", ["root", "targets", "snapshot", "timestamp"])
def test_units_follow_a_role_whose_keys_were_all_replaced(site, role):
    site.release(1)
    outcome, (key,) = rotated(site, role, revoked=["all"])
    assert outcome.published, outcome.missing
    root = site.repository.published().root.signed
    assert root.roles[role].keyids == [key.key_id]
    seen = site.seen_by_units()
    assert seen.problems == ()
    assert seen.releases["canary"].bundle_id == bundle_id(1)


@pytest.mark.parametrize("role", ["targets", "timestamp"])
def test_a_revoked_key_signs_nothing_any_more(site, role):
    old = site.keys(f"{role}-1")
    rotated(site, role, revoked=[site.key_id(f"{role}-1")[:10]], new_key_folder=site.folder / "fresh")
    others = [name for name in ("targets-1", "snapshot-1", "timestamp-1") if name != f"{role}-1"]
    before = site.snapshot_of_folder()
    site.release(1, keys=SigningKeys((*old.folders, *site.keys(*others).folders)))
    assert site.snapshot_of_folder().items() >= before.items()
    assert staged_change(site.repository) is not None
    assert not site.seen_by_units().releases


def test_a_unit_that_slept_through_many_roots_follows_them_all(site):
    for _ in range(4):
        rotated(site, "root", revoked=["all"])
    assert site.repository.newest_root_version() == 5
    assert site.seen_by_units().problems == ()


def test_one_lost_root_key_of_two_can_be_replaced(site):
    keys = site.keys("root-2", "targets-1", "snapshot-1", "timestamp-1")
    outcome, _ = rotated(site, "root", keys=keys, revoked=[site.key_id("root-1")])
    assert outcome.published
    assert site.key_id("root-1") not in site.repository.published().root.signed.keys
    assert site.seen_by_units().problems == ()


def test_when_all_root_keys_are_lost_units_need_a_new_root_by_hand(site):
    before = site.snapshot_of_folder()
    entries_count = len(site.lab.ledger())
    with pytest.raises(KeysError, match="new trusted root by hand"):
        rotated(site, "root", keys=site.keys("snapshot-1", "timestamp-1"), revoked=["all"])
    assert site.snapshot_of_folder() == before
    assert staged_change(site.repository) is None
    assert len(site.lab.ledger()) == entries_count


def test_two_of_three_root_keys_sign_one_after_the_other(tmp_path):
    site = make_site(tmp_path, root=RoleKeys(3, 2))
    before = site.snapshot_of_folder()
    outcome, _ = rotated(site, "targets", keys=site.keys("root-1", "targets-1", "snapshot-1", "timestamp-1"))
    assert not outcome.published
    assert any(line.startswith("root (its keys until now): 1 more signature") for line in outcome.missing)
    assert site.snapshot_of_folder() == before
    lines, outcome = sign_change(site.repository, site.keys("root-3"), now_unix_s=NOW_UNIX_S + 9.0)
    assert any(line.startswith("targets: new key") for line in lines)
    assert [line.split(":")[0] for line in outcome.missing] == ["snapshot", "timestamp"]
    outcome = refresh_repository(site.repository, site.keys("snapshot-1", "timestamp-1"), now_unix_s=NOW_UNIX_S + 9.0)
    assert outcome.published
    assert site.repository.newest_root_version() == 2
    assert site.seen_by_units().problems == ()


def test_a_root_that_one_of_two_needed_keys_signed_is_refused_by_units(tmp_path):
    site = make_site(tmp_path, root=RoleKeys(3, 2))
    rotated(site, "targets", keys=site.keys("root-1", "targets-1"))
    change = staged_change(site.repository)
    assert change is not None
    assert change.root is not None
    site.repository.root_path(2).write_bytes(change.root.to_bytes())
    assert "a unit would refuse the repository" in site.seen_by_units().problems[0]


def test_two_lost_of_three_with_threshold_two_is_the_end(tmp_path):
    site = make_site(tmp_path, root=RoleKeys(3, 2))
    lost = [site.key_id("root-1"), site.key_id("root-2")]
    with pytest.raises(KeysError, match="only 1 are left"):
        rotated(site, "root", keys=site.keys("root-3", "snapshot-1", "timestamp-1"), revoked=lost)


def test_both_lost_online_keys_are_replaced_in_one_step(site):
    outcome, made = rotated(site, "snapshot", "timestamp", keys=site.keys("root-1"), revoked=["all"])
    assert outcome.published
    assert [key.role for key in made] == ["snapshot", "timestamp"]
    assert site.seen_by_units().problems == ()


def test_a_threshold_can_be_raised_with_a_new_key(site):
    outcome, _ = rotated(site, "targets", thresholds={"targets": 2})
    assert outcome.published
    assert site.repository.published().root.signed.roles["targets"].threshold == 2
    assert len(site.repository.published().targets.signatures) == 2
    assert site.seen_by_units().problems == ()


def test_the_last_keys_cannot_be_revoked_without_new_ones(site):
    with pytest.raises(KeysError, match="0 keys would be left"):
        rotated(site, "targets", revoked=["all"], new_key=False)


def test_a_key_id_that_fits_no_key_of_the_role_is_refused(site):
    with pytest.raises(KeysError, match="exactly one key"):
        rotated(site, "targets", revoked=[site.key_id("root-1")])


def test_a_wrong_password_changes_nothing(site, tmp_path):
    make_key(tmp_path / "locked", "root", password=b"snow")
    entries_count, before = len(site.lab.ledger()), site.snapshot_of_folder()
    with pytest.raises(KeysError, match="password is wrong"):
        rotated(site, "root", keys=SigningKeys((tmp_path / "locked",), (b"ice",)))
    assert (len(site.lab.ledger()), site.snapshot_of_folder()) == (entries_count, before)
    assert [path.name for path in (tmp_path / "locked").iterdir()] == ["root-1.pem"]


def test_dates_are_renewed_and_the_periods_are_remembered(site):
    later = NOW_UNIX_S + 400.0 * DAY_S
    assert "expired" in site.seen_by_units(now_unix_s=later).problems[0]
    renew(site.lab, site.keys(), periods={"timestamp": 7}, by=BY, reason="late", now_unix_s=later)
    assert site.seen_by_units(now_unix_s=later + 6.9 * DAY_S).problems == ()
    assert "timestamp.json is expired" in site.seen_by_units(now_unix_s=later + 7.1 * DAY_S).problems[0]
    refresh_repository(site.repository, site.keys("snapshot-1", "timestamp-1"), now_unix_s=later + 7.0 * DAY_S)
    assert site.seen_by_units(now_unix_s=later + 13.9 * DAY_S).problems == ()


def test_a_refresh_moves_the_dates_of_today_and_nothing_else(site):
    site.release(1)
    before = site.repository.published()
    refresh_repository(site.repository, site.keys("snapshot-1", "timestamp-1"), now_unix_s=NOW_UNIX_S + 40.0 * DAY_S)
    after = site.repository.published()
    assert (after.root, after.targets) == (before.root, before.targets)
    assert after.timestamp.signed.expires > before.timestamp.signed.expires
    assert site.seen_by_units(now_unix_s=NOW_UNIX_S + 84.0 * DAY_S).problems == ()
    assert "expired" in site.seen_by_units(now_unix_s=NOW_UNIX_S + 86.0 * DAY_S).problems[0]


def test_a_refresh_without_its_keys_says_which_are_missing(site):
    with pytest.raises(KeysError, match="timestamp: 1 more signature"):
        refresh_repository(site.repository, site.keys("snapshot-1"), now_unix_s=NOW_UNIX_S)


def test_many_refreshes_do_not_fill_the_folder(site):
    for _ in range(30):
        refresh_repository(site.repository, site.keys("snapshot-1", "timestamp-1"), now_unix_s=NOW_UNIX_S)
    assert len(list(site.repository.metadata_folder.glob("*.snapshot.json"))) == 21
    assert site.seen_by_units().problems == ()


def test_an_interrupted_rotation_is_finished_by_the_next_signature(site):
    outcome, _ = rotated(site, "timestamp", "targets", keys=site.keys("root-1"), revoked=["all"])
    assert not outcome.published
    change = staged_change(site.repository)
    assert change is not None
    assert change.root is not None
    # The machine stopped after the root was out, before the timestamp was.
    site.repository.root_path(2).write_bytes(change.root.to_bytes())
    with pytest.raises(RepositoryFolderError, match="units may have seen"):
        withdraw(site.repository)
    _, outcome = sign_change(site.repository, site.keys(), now_unix_s=NOW_UNIX_S + 5.0)
    assert outcome.published
    assert site.seen_by_units().problems == ()


def test_a_change_that_was_published_before_the_machine_stopped_is_only_cleared_away(site):
    rotated(site, "timestamp", keys=site.keys("root-1"), revoked=["all"])
    staged = site.repository.change_path.read_bytes()
    sign_change(site.repository, site.keys(), now_unix_s=NOW_UNIX_S + 5.0)
    before = site.snapshot_of_folder()
    site.repository.change_path.write_bytes(staged)
    _, outcome = sign_change(site.repository, site.keys("targets-1"), now_unix_s=NOW_UNIX_S + 9.0)
    assert outcome.published
    assert not site.repository.change_path.exists()
    assert site.snapshot_of_folder() == before
