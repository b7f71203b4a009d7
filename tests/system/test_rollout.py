"""A unit in a process of its own, a signed repository, traffic: what becomes of releases, and of the passages."""

from __future__ import annotations

import json
import random
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from roadgrip.features import NEWEST_TABLE, PAPER_TABLE, FeatureTable
from roadgrip.section import RoadSection
from roadgrip.sections import read_section
from rsu_app.control_client import ask
from tests.bundles import make_bundle, make_bundle_of_tables
from tests.repositories import SignedRepository
from tests.rsu_app.fakes import make_passage
from tests.rsu_app.sites import passage_json
from tests.system.daemons import Daemon

pytestmark = pytest.mark.system

SHADOW_COUNT = 20
PATIENCE_S = 60.0
SETTINGS = f"""
[updates]
source = "repository"
trusted_root = "trusted-root.json"
ring = "canary"
poll_period_s = 1.0
shadow_count = {SHADOW_COUNT}
probation_count = {SHADOW_COUNT}
judged_from_count = 5
"""
NEARBY = {"sideslip_mean_rad": 1.0, "steer_mean_rad": 1e-6}
"""A model that hardly differs from the usual one."""


@pytest.fixture
def repository(tmp_path) -> SignedRepository:
    repository = SignedRepository(tmp_path / "repository")
    (tmp_path / "trusted-root.json").write_bytes(repository.trusted_root)
    return repository


class Traffic:
    """Vehicles that pass one after another until they are told to stop; each waits for its receipt.

    Args:
        daemon: The unit they send to.
        tables: The feature tables of the vehicles, in turn.
        first_seed: Tells its vehicles from others.
    """

    def __init__(
        self, daemon: Daemon, tables: tuple[FeatureTable, ...] = (NEWEST_TABLE,), *, first_seed: int = 1
    ) -> None:
        self.section: RoadSection = read_section("long-turn")
        self.accepted: list[bytes] = []
        self.refused: list[dict[str, object]] = []
        self.mu = 0.5
        self._client = daemon.client
        self._tables = tables
        self._seeds = iter(range(first_seed, first_seed + 10**6))
        self._stop = threading.Event()

    def pass_one(self) -> None:
        seed = next(self._seeds)
        table = self._tables[seed % len(self._tables)]
        passage = make_passage(self.section, seed=seed, mu=self.mu, table=table)
        answer = self._client.post(f"/v1/sections/{self.section.section_id}/passages", json=passage_json(passage))
        if answer.status_code < 300:
            self.accepted.append(passage.passage_id)
        else:
            self.refused.append(answer.json())

    @contextmanager
    def flowing(self) -> Iterator[None]:
        def drive() -> None:
            while not self._stop.is_set():
                self.pass_one()

        thread = threading.Thread(target=drive)
        thread.start()
        try:
            yield
        finally:
            self._stop.set()
            thread.join()


def wait_until(what: Callable[[], bool]) -> None:
    give_up_s = time.monotonic() + PATIENCE_S
    while not what():
        assert time.monotonic() < give_up_s, "it never came"
        time.sleep(0.05)


def command(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", "-m", "rsu_app", *arguments, "--config", str(folder / "rsu.toml")],
        capture_output=True,
        text=True,
        check=False,
    )


def status(folder: Path) -> dict[str, object]:
    told = ask(folder / "roadgrip-models" / "control.sock", "/status")
    assert told is not None
    model: dict[str, object] = told["model"]
    return model


def live_id(daemon: Daemon) -> str:
    """Return the bundle that the newest stored passage names."""
    return str(daemon.rows("SELECT bundle_id FROM passages ORDER BY sequence_number DESC LIMIT 1")[0][0])


def actions(daemon: Daemon) -> list[str]:
    return [row[0] for row in daemon.rows("SELECT action FROM ledger ORDER BY sequence_number")]


def test_a_release_becomes_live_under_traffic_and_no_passage_is_lost(tmp_path, repository):
    with Daemon(tmp_path, SETTINGS) as daemon:
        traffic = Traffic(daemon)
        with traffic.flowing():
            wait_until(lambda: len(traffic.accepted) > 20)
            newer = make_bundle(tmp_path / "newer", name="newer", weights=NEARBY)
            repository.release(tmp_path / "newer", sequence_number=1)
            wait_until(lambda: "confirmed" in actions(daemon))
            wait_until(lambda: live_id(daemon) == newer.bundle_id)
        assert traffic.refused == []
        assert [stored.passage_id for stored in daemon.stored()] == traffic.accepted
        bundles = [row[0] for row in daemon.rows("SELECT bundle_id FROM passages ORDER BY sequence_number")]
        first_new = bundles.index(newer.bundle_id)
        assert set(bundles[first_new:]) == {newer.bundle_id}
        shadowed = daemon.rows("SELECT count(*) FROM passages WHERE shadow_mu IS NOT NULL")[0][0]
        assert shadowed >= 2 * SHADOW_COUNT
        assert command(tmp_path, "ledger", "verify").returncode == 0
        assert daemon.metric("roadgrip_bundle_info", role="live", bundle=newer.bundle_id) == 1


def test_a_bundle_that_goes_wrong_once_it_is_live_is_rolled_back_by_itself(tmp_path, repository):
    with Daemon(tmp_path, SETTINGS) as daemon:
        traffic = Traffic(daemon)
        factory_id = status(tmp_path)["live_bundle_id"]
        # Alike where the road is dry, and half as much again where it is not.
        make_bundle(tmp_path / "bad", weights={"sideslip_mean_rad": 0.25}, bias_mu=0.5)
        repository.release(tmp_path / "bad", sequence_number=1)
        wait_until(lambda: status(tmp_path)["stage"] == "shadow")
        for _ in range(SHADOW_COUNT):
            traffic.pass_one()
        wait_until(lambda: status(tmp_path)["stage"] == "probation")
        traffic.mu = 0.3
        for _ in range(SHADOW_COUNT // 2):
            traffic.pass_one()
        wait_until(lambda: status(tmp_path)["live_bundle_id"] == factory_id)
        traffic.pass_one()
        assert live_id(daemon) == factory_id
        assert traffic.refused == []
        assert actions(daemon)[-1] == "rolled_back"


@pytest.mark.parametrize("seed", [pytest.param(seed, marks=pytest.mark.long) for seed in (0, 1, 2)])
def test_a_unit_that_is_killed_in_the_middle_of_a_rollout_comes_back_with_a_verified_model(tmp_path, repository, seed):
    wait_s = random.Random(seed).uniform(0.0, 1.5)
    known = {make_bundle(tmp_path / "bundle").bundle_id}
    for number in (1, 2):
        weights = {"sideslip_mean_rad": 1.0, "steer_mean_rad": number * 1e-6}
        known.add(make_bundle(tmp_path / f"newer-{number}", weights=weights).bundle_id)
    with Daemon(tmp_path, SETTINGS) as daemon:
        traffic = Traffic(daemon)
        repository.release(tmp_path / "newer-1", sequence_number=1)
        begun_s = time.monotonic()
        while time.monotonic() < begun_s + 1.0 + wait_s:
            traffic.pass_one()
        repository.release(tmp_path / "newer-2", sequence_number=2)
        daemon.kill()
    accepted = traffic.accepted
    with Daemon(tmp_path, SETTINGS) as again:
        assert again.client.get("/health/ready").json()["ready"]
        assert status(tmp_path)["live_bundle_id"] in known
        assert set(accepted) <= {stored.passage_id for stored in again.stored()}
        traffic = Traffic(again, first_seed=2 * 10**6)
        with traffic.flowing():
            wait_until(lambda: actions(again)[-1] == "confirmed" and live_id(again) == repository_newest(tmp_path))
        assert command(tmp_path, "ledger", "verify").returncode == 0


def repository_newest(folder: Path) -> str:
    return str(json.loads((folder / "newer-2" / "manifest.json").read_text())["bundle_id"])


def test_vehicles_of_two_versions_are_served_through_an_upgrade(tmp_path, repository):
    make_bundle_of_tables(tmp_path / "bundle", (PAPER_TABLE,), biases_mu=(0.5,))
    with Daemon(tmp_path, SETTINGS) as daemon:
        assert offered(daemon) == [PAPER_TABLE.digest]
        old = Traffic(daemon, (PAPER_TABLE,))
        both = Traffic(daemon, (NEWEST_TABLE, PAPER_TABLE), first_seed=2 * 10**6)
        for _ in range(SHADOW_COUNT // 2):
            old.pass_one()
        newer = make_bundle_of_tables(tmp_path / "newer", (NEWEST_TABLE, PAPER_TABLE), biases_mu=(0.5, 0.5))
        repository.release(tmp_path / "newer", sequence_number=1)
        with old.flowing():
            wait_until(lambda: actions(daemon)[-1] == "confirmed")
        assert offered(daemon) == [NEWEST_TABLE.digest, PAPER_TABLE.digest]
        for _ in range(10):
            both.pass_one()
        assert (old.refused, both.refused) == ([], [])
        tables = daemon.rows("SELECT DISTINCT table_digest FROM passages WHERE bundle_id = ?", newer.bundle_id)
        assert {row[0] for row in tables} == {NEWEST_TABLE.digest, PAPER_TABLE.digest}


def offered(daemon: Daemon) -> list[str]:
    digests: list[str] = daemon.client.get("/v1/sections").json()["sections"][0]["table_digests"]
    return digests


def test_a_unit_is_handed_a_repository_while_it_does_not_run(tmp_path, repository):
    settings = SETTINGS.replace('source = "repository"\n', "")
    with Daemon(tmp_path, settings):
        pass
    newer = make_bundle(tmp_path / "newer", name="newer", weights=NEARBY)
    repository.release(tmp_path / "newer", sequence_number=1)
    told = command(tmp_path, "update", "--from", str(repository.folder), "--by", "ann")
    assert (told.returncode, "shadow" in told.stdout) == (0, True)
    with Daemon(tmp_path, settings):
        assert status(tmp_path)["stage"] == "shadow"
        told = command(tmp_path, "switch", "--reason", "the pass is closed, nobody drives", "--by", "ann")
        assert (told.returncode, newer.bundle_id in told.stdout) == (0, True)
        told = command(tmp_path, "rollback", "--reason", "it reads too high", "--by", "ann")
        assert told.returncode == 0
        assert status(tmp_path)["live_bundle_id"] != newer.bundle_id
        assert command(tmp_path, "rollback", "--reason", "again").returncode == 1
    shown = json.loads(command(tmp_path, "ledger", "show", "--json").stdout)["entries"]
    assert {(entry["action"], entry["actor"]) for entry in shown} >= {
        ("installed", "ann"),
        ("switched", "ann"),
        ("rolled_back", "ann"),
    }


def test_a_foreign_repository_is_refused_with_an_alarm_and_the_unit_goes_on(tmp_path, repository):
    make_bundle(tmp_path / "newer", name="newer", weights=NEARBY)
    foreign = SignedRepository(tmp_path / "foreign")
    foreign.release(tmp_path / "newer", sequence_number=1)
    with Daemon(tmp_path, SETTINGS.replace('"repository"', '"foreign"')) as daemon:
        wait_until(lambda: daemon.metric("roadgrip_update_refusals_total", reason="bad_signature") > 0)
        assert daemon.client.get("/health/ready").json()["ready"]
        traffic = Traffic(daemon)
        traffic.pass_one()
        assert traffic.refused == []
        told = command(tmp_path, "update")
        assert (told.returncode, told.stdout.startswith("bad_signature")) == (1, True)


def test_only_the_unit_s_own_account_may_open_its_control_socket(tmp_path):
    with Daemon(tmp_path):
        mode = (tmp_path / "roadgrip-models" / "control.sock").stat().st_mode
        assert mode & 0o077 == 0
    told = command(tmp_path, "status")
    assert (told.returncode, "no unit runs" in told.stdout) == (1, True)


def test_a_unit_without_a_place_for_its_shelf_serves_all_the_same(tmp_path):
    (tmp_path / "full").write_text("")
    with Daemon(tmp_path, '[updates]\nfolder = "full/shelf"\n') as daemon:
        assert daemon.client.get("/health/ready").json()["ready"]
        assert any(line["event"] == "control_unavailable" for line in daemon.lines())


def test_two_units_cannot_share_a_shelf(tmp_path):
    with Daemon(tmp_path):
        told = command(tmp_path, "serve")
        assert told.returncode == 2
        assert "another unit answers" in told.stderr
