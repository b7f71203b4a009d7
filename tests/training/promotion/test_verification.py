"""What units say to a repository that somebody has touched, swapped, mixed or forgotten."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from tuf.api.exceptions import DownloadHTTPError
from tuf.ngclient import FetcherInterface, Updater

from roadgrip.release import bundle_target, release_from_json, ring_target
from rsu_app.adapters.updates.repository import TufReleaseSource
from tests.training.promotion.laboratories import DAY_S, NOW_UNIX_S, bundle_files, bundle_id, make_site
from training.promotion.repository import Repository
from training.promotion.verification import verify


@pytest.fixture
def site(tmp_path):
    site = make_site(tmp_path)
    site.release(1, "canary")
    site.release(1, "all")
    site.release(2, "canary")
    return site


class PlainFetcher(FetcherInterface):
    """Written apart from the one under test, for a unit that knows nothing of the laboratory's code."""

    def _fetch(self, url):
        path = Path(urlsplit(url).path)
        if not path.exists():
            raise DownloadHTTPError(url, 404)
        return iter([path.read_bytes()])


@pytest.fixture
def site_of_today(tmp_path):
    """For clients that ask the clock themselves."""
    now_unix_s = time.time()
    site = make_site(tmp_path, now_unix_s=now_unix_s)
    site.release(1, "all", now_unix_s=now_unix_s)
    return site


def test_the_client_as_the_library_ships_it_finds_its_way(site_of_today, tmp_path):
    repository = site_of_today.repository
    updater = Updater(
        str(tmp_path / "memory"),
        repository.metadata_folder.as_uri(),
        str(tmp_path),
        repository.targets_folder.as_uri(),
        fetcher=PlainFetcher(),
        bootstrap=site_of_today.trusted_root,
    )
    pointer = updater.get_targetinfo(ring_target("all"))
    assert pointer is not None
    release = release_from_json(Path(updater.download_target(pointer)).read_text())
    assert release.bundle_id == bundle_id(1)
    for name, content in bundle_files(1).items():
        file = updater.get_targetinfo(bundle_target(release.bundle_id, name))
        assert file is not None
        assert Path(updater.download_target(file)).read_bytes() == content


def test_the_road_side_unit_takes_a_release(site_of_today, tmp_path):
    source = TufReleaseSource(
        str(site_of_today.repository.folder),
        trusted_root=site_of_today.folder / "trusted-root.json",
        cache_folder=tmp_path / "cache",
        unix_s=time.time,
    )
    fetched = source.fetch("all", newer_than=0, into=tmp_path / "into")
    seen = site_of_today.seen_by_units(now_unix_s=time.time())
    assert fetched is not None
    assert getattr(fetched, "release", fetched) == seen.releases["all"]
    assert {path.name: path.read_bytes() for path in (tmp_path / "into").iterdir()} == bundle_files(1)


def damaged(content: bytes, how: str) -> bytes:
    if how == "cut":
        return content[:-1]
    position = len(content) // 3
    return content[:position] + bytes([content[position] ^ 0x01]) + content[position + 1 :]


@pytest.mark.parametrize("how", ["flipped", "cut", "gone"])
def test_no_file_can_be_touched_unnoticed(site, how):
    assert site.seen_by_units().problems == ()
    unnoticed = []
    for name, content in site.snapshot_of_folder().items():
        path = site.repository.folder / name
        old_metadata = name.startswith("metadata/") and name.split("/")[1][:2] in {"1.", "2.", "3."}
        idle = "root" not in name and (old_metadata or path in site.repository.surplus_files(_targets(site)))
        if how == "gone" and idle:
            continue  # an old version may go at any time
        path.write_bytes(damaged(content, how))
        if how == "gone":
            path.unlink()
        if not site.seen_by_units().problems:
            unnoticed.append(name)
        path.write_bytes(content)
    assert unnoticed == []
    assert site.seen_by_units().problems == ()


def _targets(site):
    return site.repository.published().targets.signed


def test_a_file_that_nobody_signed_is_told(site):
    (site.repository.targets_folder / "rings" / "extra.json").write_text("{}")
    (site.repository.metadata_folder / "9.mirrors.json").write_text("{}")
    assert [problem.split(" ")[0] for problem in site.seen_by_units().problems] == [
        "targets/rings/extra.json",
        "metadata/9.mirrors.json",
    ]


def test_a_repository_of_somebody_else_is_refused(site, tmp_path):
    other = make_site(tmp_path / "other")
    other.release(3)
    seen = verify(other.repository, site.trusted_root, now_unix_s=NOW_UNIX_S)
    assert dict(seen.releases) == {}
    assert "a unit would refuse the repository" in seen.problems[0]


def test_what_is_no_root_is_no_trusted_root(site):
    seen = verify(site.repository, b"{}", now_unix_s=NOW_UNIX_S)
    assert "a unit would refuse the repository" in seen.problems[0]


def test_a_mix_of_two_states_of_a_repository_is_refused(site, tmp_path):
    older = tmp_path / "older"
    shutil.copytree(site.repository.folder, older)
    site.release(3, "all")
    for name in ("timestamp.json", "4.snapshot.json", "4.targets.json"):
        mixed = tmp_path / f"mixed-{name}"
        shutil.copytree(site.repository.folder, mixed)
        # The newer content under the older name, and the other way round.
        newer = site.repository.metadata_folder / name.replace("4.", "5.")
        (mixed / "metadata" / name).write_bytes(newer.read_bytes())
        if name == "timestamp.json":
            (mixed / "metadata" / "5.snapshot.json").write_bytes((older / "metadata" / "4.snapshot.json").read_bytes())
        else:
            (mixed / "metadata" / "timestamp.json").write_bytes((older / "metadata" / "timestamp.json").read_bytes())
        seen = verify(Repository(mixed), site.trusted_root, now_unix_s=NOW_UNIX_S)
        assert seen.problems, name
        assert not seen.releases, name


def test_a_mirror_that_got_only_half_of_the_news_still_gives_the_old_state(site, tmp_path):
    mirror = tmp_path / "mirror"
    shutil.copytree(site.repository.folder, mirror)
    site.release(3, "all")
    for name, content in site.snapshot_of_folder().items():
        if name != "metadata/timestamp.json":
            (mirror / name).parent.mkdir(parents=True, exist_ok=True)
            (mirror / name).write_bytes(content)
    seen = verify(Repository(mirror), site.trusted_root, now_unix_s=NOW_UNIX_S)
    assert seen.problems == ()
    assert seen.releases["all"].bundle_id == bundle_id(1)


@pytest.mark.parametrize(("days", "good"), [(44.0, True), (46.0, False)])
def test_a_stick_is_good_for_six_weeks(site, days, good):
    assert (site.seen_by_units(now_unix_s=NOW_UNIX_S + days * DAY_S).problems == ()) == good


def test_a_folder_with_a_name_that_addresses_must_quote_is_read(site, tmp_path):
    odd = tmp_path / "stick of Kåre #1 100%"
    shutil.copytree(site.repository.folder, odd)
    assert verify(Repository(odd), site.trusted_root, now_unix_s=NOW_UNIX_S).problems == ()


def test_a_trusted_root_in_the_folder_that_is_not_the_first_is_told(site):
    site.repository.trusted_root_path.write_bytes(site.trusted_root + b" ")
    assert site.seen_by_units().problems == ("trusted-root.json is not the first root",)
