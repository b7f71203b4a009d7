"""A bundle becomes the release of a ring: in the ledger, signed by all who must, and readable by units."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import pytest

from roadgrip.bundle import MANIFEST_NAME
from roadgrip.errors import BundleError
from roadgrip.ledger import Action, chain_problems
from roadgrip.release import ReleaseError
from tests.training.promotion.laboratories import (
    BY,
    NOW_UNIX_S,
    bundle_files,
    bundle_folder,
    bundle_id,
    make_site,
)
from training.promotion.ceremony import RoleKeys, begin_repository
from training.promotion.change import refresh, staged_change
from training.promotion.change import sign as sign_change
from training.promotion.decision import PromotionError
from training.promotion.keys import KeysError, SigningKeys, make_key
from training.promotion.publication import (
    VerdictOnBundle,
    checked_bundle,
    ledger_problems,
    promote,
    prune,
    publish_release,
    read_bundle,
    withdraw_change,
)
from training.promotion.repository import RepositoryFolderError, bundle_ids


@pytest.fixture
def site(tmp_path):
    return make_site(tmp_path)


def promoted(site, number, ring="canary", *, against=None, passed=True, override=None, keys=None):
    """Promote a bundle on which the gate has said something: against None, or a bundle's number."""
    champion_id = None if against is None else bundle_id(against)
    verdict = VerdictOnBundle("d" * 64, bundle_id(number), champion_id, passed)
    return promote(
        site.lab,
        keys or site.keys(),
        bundle=read_bundle(bundle_folder(site.folder, number)),
        ring=ring,
        verdicts={champion_id: verdict},
        reason="better in the wet",
        override_reason=override,
        by=BY,
        now_unix_s=NOW_UNIX_S,
    )


def test_units_get_the_bundle_of_their_ring(site):
    site.release(1, "canary")
    site.release(1, "all")
    site.release(2, "canary")
    seen = site.seen_by_units()
    assert seen.problems == ()
    assert {ring: release.bundle_id for ring, release in seen.releases.items()} == {
        "all": bundle_id(1),
        "canary": bundle_id(2),
    }


def test_a_release_says_what_was_decided(site):
    release = site.release(1, verdict_digest="e" * 64)
    assert (release.ring, release.gate, release.reason, release.released_by) == (
        "canary",
        "passed",
        "better in the wet",
        BY,
    )
    assert release.released_unix_s == int(NOW_UNIX_S)
    assert set(release.files_sha256) == set(bundle_files(1))
    assert site.seen_by_units().releases["canary"] == release


def test_sequence_numbers_grow_over_all_rings(site):
    releases = [
        site.release(number, ring) for number, ring in ((1, "canary"), (1, "all"), (2, "canary"), (1, "canary"))
    ]
    assert [release.sequence_number for release in releases] == [1, 2, 3, 4]


def test_sequence_numbers_go_on_in_a_repository_that_was_begun_again(site, tmp_path):
    site.release(1)
    site.lab.repository_folder.rename(tmp_path / "old-repository")
    begin_repository(site.lab, tmp_path / "new-keys", by=BY, now_unix_s=NOW_UNIX_S)
    assert site.release(2, keys=SigningKeys((tmp_path / "new-keys",))).sequence_number == 2


def test_the_ledger_entry_comes_with_the_evidence_and_its_hash_rides_in_the_release(site):
    release = site.release(1, verdict_digest="e" * 64)
    entry = site.lab.ledger()[-1]
    assert (entry.action, entry.subject, entry.actor, entry.entry_hash) == (
        Action.PROMOTED,
        bundle_id(1),
        BY,
        release.ledger_hash,
    )
    assert (
        entry.evidence.items()
        >= {
            "ring": "canary",
            "sequence_number": "1",
            "gate": "passed",
            "verdict": "e" * 64,
        }.items()
    )
    assert len(entry.evidence["files_sha256"]) == 64


def test_every_release_of_the_repository_is_looked_for_in_the_ledger(site):
    site.release(1)
    site.release(2, "all")
    entries = site.lab.ledger()
    assert ledger_problems(site.lab, entries) == []
    assert [line.split(":")[0] for line in ledger_problems(site.lab, entries[:-1])] == ["ring all"]
    lines = site.lab.ledger_path.read_text().splitlines()
    site.lab.ledger_path.write_text("".join(f"{line}\n" for line in lines[:-1]))
    site.lab.record(Action.JUDGED, bundle_id(2), reason="in its place", now_unix_s=NOW_UNIX_S)
    assert chain_problems(site.lab.ledger()) == []
    assert len(ledger_problems(site.lab, site.lab.ledger())) == 1


def test_a_step_back_is_a_new_release_of_what_the_repository_holds(site):
    site.release(1, "all")
    site.release(2, "all")
    files = site.repository.bundle_files(site.repository.published().targets.signed, bundle_id(1))
    assert files == bundle_files(1)
    release, outcome = promote(
        site.lab,
        site.keys(),
        bundle=checked_bundle(files, where="the repository"),
        ring="all",
        verdicts={},
        reason="frost in the canary ring",
        override_reason="two false warnings",
        by=BY,
        now_unix_s=NOW_UNIX_S,
    )
    assert outcome.published
    assert (release.sequence_number, release.gate) == (3, "overridden")
    assert site.seen_by_units().releases["all"].bundle_id == bundle_id(1)


def test_a_folder_that_is_no_bundle_is_refused_before_anything_is_written(site, tmp_path):
    before, entries_count = site.snapshot_of_folder(), len(site.lab.ledger())
    broken = bundle_folder(tmp_path, 1)
    (broken / "model.onnx").write_bytes(b"another model")
    for folder in (broken, tmp_path, tmp_path / "missing"):
        with pytest.raises(BundleError):
            publish_release(
                site.lab,
                site.keys(),
                bundle_folder=folder,
                ring="canary",
                gate="passed",
                verdict_digest=None,
                reason="",
                by=BY,
                now_unix_s=NOW_UNIX_S,
            )
    assert (site.snapshot_of_folder(), len(site.lab.ledger())) == (before, entries_count)


@pytest.mark.parametrize("wrong", [{"ring": "All of them"}, {"gate": "perhaps"}])
def test_what_is_no_release_is_refused_before_the_ledger_knows_of_it(site, wrong):
    entries_count = len(site.lab.ledger())
    with pytest.raises(ReleaseError):
        site.release(1, wrong.get("ring", "canary"), **({"gate": wrong["gate"]} if "gate" in wrong else {}))
    assert len(site.lab.ledger()) == entries_count


def test_the_same_models_under_another_manifest_are_refused(site):
    site.release(1)
    other = bundle_folder(site.folder, 1, note=" again")
    assert read_bundle(other).manifest.bundle_id == bundle_id(1)
    with pytest.raises(RepositoryFolderError, match=f"another {MANIFEST_NAME}"):
        publish_release(
            site.lab,
            site.keys(),
            bundle_folder=other,
            ring="all",
            gate="passed",
            verdict_digest=None,
            reason="",
            by=BY,
            now_unix_s=NOW_UNIX_S,
        )
    assert site.seen_by_units().problems == ()


# Promotion -----------------------------------------------------------------------------------------------------------


def test_a_bundle_that_passed_goes_through_the_rings(site):
    site.release(1, "all")
    assert promoted(site, 2, "canary", against=1)[0].gate == "passed"
    assert promoted(site, 2, "all", against=1)[0].gate == "passed"
    assert site.lab.ledger()[-1].evidence["verdict"] == "d" * 64


def test_a_verdict_against_a_former_champion_counts_for_nothing(site):
    site.release(1, "all")
    site.release(3, "all")
    with pytest.raises(PromotionError, match=f"said nothing of it against the champion {bundle_id(3)}"):
        promoted(site, 2, against=1)


def test_a_bundle_that_failed_is_refused_and_the_override_is_recorded(site):
    site.release(1, "all")
    entries_count = len(site.lab.ledger())
    with pytest.raises(PromotionError, match="failed it"):
        promoted(site, 2, against=1, passed=False)
    assert len(site.lab.ledger()) == entries_count
    release, _ = promoted(site, 2, against=1, passed=False, override="the road is closed anyway")
    assert release.gate == "overridden"
    assert site.lab.ledger()[-1].evidence["override"] == "the road is closed anyway"


def test_an_override_without_a_reason_is_none(site):
    with pytest.raises(PromotionError, match="needs a reason"):
        promoted(site, 1, override="  ")


def test_a_verdict_on_another_bundle_is_not_borrowed(site):
    verdict = VerdictOnBundle("d" * 64, bundle_id(1), None, passed=True)
    with pytest.raises(PromotionError, match="is about bundle"):
        promote(
            site.lab,
            site.keys(),
            bundle=read_bundle(bundle_folder(site.folder, 2)),
            ring="canary",
            verdicts={None: verdict},
            reason="",
            override_reason=None,
            by=BY,
            now_unix_s=NOW_UNIX_S,
        )


# Signatures of several -----------------------------------------------------------------------------------------------


def test_two_holders_of_targets_keys_sign_one_after_the_other(tmp_path):
    site = make_site(tmp_path, targets=RoleKeys(2, 2))
    before = site.metadata()
    release, outcome = promoted(site, 1, keys=site.keys("targets-1", "snapshot-1", "timestamp-1"))
    assert not outcome.published
    assert outcome.missing == (f"targets: 1 more signature, of {site.key_id('targets-2')[:12]}",)
    assert site.metadata() == before
    assert site.seen_by_units().releases == {}
    lines, outcome = sign_change(
        site.repository, site.keys("targets-2", "snapshot-1", "timestamp-1"), now_unix_s=NOW_UNIX_S
    )
    assert any(bundle_id(1) in line and "ring canary" in line for line in lines)
    assert outcome.published
    assert outcome.release == release
    seen = site.seen_by_units()
    assert seen.problems == ()
    assert seen.releases["canary"] == release


def test_one_holder_who_signs_twice_counts_once(tmp_path):
    site = make_site(tmp_path, targets=RoleKeys(2, 2))
    keys = site.keys("targets-1", "snapshot-1", "timestamp-1")
    promoted(site, 1, keys=keys)
    _, outcome = sign_change(site.repository, keys, now_unix_s=NOW_UNIX_S)
    assert not outcome.published


def test_a_change_that_waits_keeps_others_from_beginning(tmp_path):
    site = make_site(tmp_path, targets=RoleKeys(2, 2))
    promoted(site, 1, keys=site.keys("targets-1"))
    entries_count = len(site.lab.ledger())
    with pytest.raises(RepositoryFolderError, match="waits for signatures"):
        promoted(site, 2)
    assert len(site.lab.ledger()) == entries_count


def test_dates_are_refreshed_while_a_change_waits(tmp_path):
    site = make_site(tmp_path, targets=RoleKeys(2, 2))
    promoted(site, 1, keys=site.keys("targets-1"))
    outcome = refresh(site.repository, site.keys("snapshot-1", "timestamp-1"), now_unix_s=NOW_UNIX_S + 9.0)
    assert outcome.release is None
    assert site.seen_by_units().releases == {}
    _, outcome = sign_change(site.repository, site.keys(), now_unix_s=NOW_UNIX_S + 10.0)
    assert outcome.published
    assert site.seen_by_units().problems == ()


def test_a_refresh_publishes_what_only_waits_for_its_keys(site):
    release, outcome = promoted(site, 1, keys=site.keys("targets-1"))
    assert [line.split(":")[0] for line in outcome.missing] == ["snapshot", "timestamp"]
    outcome = refresh(site.repository, site.keys("snapshot-1", "timestamp-1"), now_unix_s=NOW_UNIX_S)
    assert outcome.release == release
    assert site.seen_by_units().releases["canary"] == release


def test_a_withdrawn_promotion_was_never_in_its_ring(site):
    site.release(1, "all")
    promoted(site, 2, against=1, keys=site.keys("snapshot-1", "timestamp-1"))
    assert "bundle" in withdraw_change(site.lab, reason="wrong bundle", by=BY, now_unix_s=NOW_UNIX_S)
    assert staged_change(site.repository) is None
    assert site.lab.ledger()[-1].action is Action.REFUSED
    with pytest.raises(PromotionError, match="never in ring 'canary'"):
        promoted(site, 2, "all", against=1)
    assert promoted(site, 2, "canary", against=1)[0].sequence_number == 3


def test_a_change_that_somebody_altered_on_the_way_does_not_count_as_signed(tmp_path):
    site = make_site(tmp_path, targets=RoleKeys(2, 2))
    promoted(site, 1, keys=site.keys("targets-1", "snapshot-1", "timestamp-1"))
    path = site.repository.change_path
    path.write_text(path.read_text().replace('"version": 2', '"version": 3'))
    with pytest.raises(RepositoryFolderError, match="made for targets 2"):
        sign_change(site.repository, site.keys("targets-2"), now_unix_s=NOW_UNIX_S)
    path.write_text(path.read_text().replace('"version": 3', '"version": 2').replace('"length": ', '"length": 1'))
    with pytest.raises(RepositoryFolderError, match="not what was signed"):
        sign_change(site.repository, site.keys("targets-2"), now_unix_s=NOW_UNIX_S)


def test_a_damaged_change_can_only_be_withdrawn(site):
    promoted(site, 1, keys=site.keys("targets-1"))
    site.repository.change_path.write_text('{"format_version": 1')
    with pytest.raises(RepositoryFolderError, match="damaged"):
        sign_change(site.repository, site.keys(), now_unix_s=NOW_UNIX_S)
    withdraw_change(site.lab, reason="damaged", by=BY, now_unix_s=NOW_UNIX_S)
    assert promoted(site, 1)[1].published


@pytest.mark.parametrize("stopped_at", ["3.targets.json", "3.snapshot.json", "timestamp.json"])
def test_an_interrupted_publication_leaves_the_old_state_and_is_finished_later(site, stopped_at):
    site.release(1)
    obstacle = site.repository.metadata_folder / f".{stopped_at}.partial"
    obstacle.mkdir()
    with pytest.raises(IsADirectoryError):
        site.release(2)
    obstacle.rmdir()
    seen = site.seen_by_units()
    assert seen.problems == ()
    assert seen.releases["canary"].bundle_id == bundle_id(1)
    _, outcome = sign_change(site.repository, site.keys(), now_unix_s=NOW_UNIX_S)
    assert outcome.published
    seen = site.seen_by_units()
    assert seen.problems == ()
    assert seen.releases["canary"].bundle_id == bundle_id(2)


# Distrust ------------------------------------------------------------------------------------------------------------


def test_nothing_is_built_upon_targets_that_somebody_else_wrote(site):
    site.release(1)
    path = site.repository.metadata_folder / "2.targets.json"
    path.write_text(path.read_text().replace(bundle_id(1), "0" * 16))
    entries_count = len(site.lab.ledger())
    with pytest.raises(RepositoryFolderError, match="must not be trusted"):
        site.release(2)
    assert len(site.lab.ledger()) == entries_count


def test_keys_refuse_to_sign_in_a_repository_that_is_not_theirs(site, tmp_path):
    other = make_site(tmp_path / "other")
    (other.folder / "keys" / "targets-1" / "trusted-root.json").write_bytes(other.trusted_root)
    with pytest.raises(KeysError, match="another repository's"):
        site.release(1, keys=other.keys("targets-1"))
    assert staged_change(site.repository) is None


def test_a_holder_does_not_sign_for_a_repository_that_was_replaced(site, tmp_path):
    replaced = make_site(tmp_path / "replaced")
    replaced.release(1, keys=replaced.keys("snapshot-1"))
    holder = site.keys("targets-1")
    (holder.folders[0] / "trusted-root.json").write_bytes(site.trusted_root)
    waiting = replaced.repository.change_path.read_bytes()
    with pytest.raises(KeysError, match="another repository's"):
        sign_change(replaced.repository, holder, now_unix_s=NOW_UNIX_S)
    assert replaced.repository.change_path.read_bytes() == waiting


def test_the_keys_of_somebody_else_sign_nothing(site, tmp_path):
    other = make_site(tmp_path / "other")
    site.release(1, keys=other.keys())
    change = staged_change(site.repository)
    assert change is not None
    assert change.targets is not None
    assert change.targets.signatures == {}


def test_a_key_that_cannot_be_opened_is_told_before_the_ledger_knows_of_anything(site, tmp_path):
    make_key(tmp_path / "locked", "targets", password=b"snow")
    entries_count = len(site.lab.ledger())
    with pytest.raises(KeysError, match="give --password-file"):
        site.release(1, keys=SigningKeys((tmp_path / "locked",)))
    assert len(site.lab.ledger()) == entries_count


# Old bundles ---------------------------------------------------------------------------------------------------------


def test_pruning_keeps_what_runs_and_the_newest_of_the_rest(site):
    for number in (1, 2, 3, 4, 5):
        site.release(number, "all" if number == 2 else "canary")
    outcome, gone = prune(site.lab, site.keys(), kept_count=2, now_unix_s=NOW_UNIX_S)
    assert outcome is not None
    assert outcome.published
    assert gone == (bundle_id(1),)
    held = site.repository.published().targets.signed
    assert set(bundle_ids(held)) == {bundle_id(number) for number in (2, 3, 4, 5)}
    assert site.repository.surplus_files(held) == []
    assert not list(site.repository.targets_folder.glob(f"bundles/{bundle_id(1)}/*"))
    assert site.seen_by_units().problems == ()


def test_pruning_nothing_needs_no_signature(site):
    site.release(1)
    site.release(1)
    version = site.repository.published().targets.signed.version
    assert len(site.repository.surplus_files(site.repository.published().targets.signed)) == 1
    assert prune(site.lab, site.keys("snapshot-1"), now_unix_s=NOW_UNIX_S) == (None, ())
    published = site.repository.published().targets.signed
    assert (published.version, site.repository.surplus_files(published)) == (version, [])


def test_a_pruned_bundle_can_come_back(site):
    for number in (1, 2, 1):
        site.release(number)
        prune(site.lab, site.keys(), kept_count=0, now_unix_s=NOW_UNIX_S)
    assert site.seen_by_units().problems == ()
    assert bundle_ids(site.repository.published().targets.signed) == [bundle_id(1)]


# Two commands at once ------------------------------------------------------------------------------------------------


def test_commands_at_the_same_time_follow_one_another(site):
    # The lock belongs to the opened file, so threads exclude one another as processes do.
    begun = Barrier(2)

    def release_some(first: int, ring: str) -> None:
        begun.wait()
        for number in range(first, first + 4):
            site.release(number, ring)
            refresh(site.repository, site.keys(), now_unix_s=NOW_UNIX_S)

    with ThreadPoolExecutor(2) as pool:
        for ended in [pool.submit(release_some, 10, "canary"), pool.submit(release_some, 20, "all")]:
            ended.result()
    promotions = [entry for entry in site.lab.ledger() if entry.action is Action.PROMOTED]
    numbers = [int(entry.evidence["sequence_number"]) for entry in promotions]
    assert numbers == list(range(1, 9))
    assert chain_problems(site.lab.ledger()) == []
    assert site.seen_by_units().problems == ()
    assert ledger_problems(site.lab, site.lab.ledger()) == []
