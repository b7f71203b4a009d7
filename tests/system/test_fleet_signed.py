"""Whole fleets and a unit that sign what they say: who is believed, who is refused, and whether it learns why."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from bench.certified import AUTHORITY_KEY, OTHER_AUTHORITY_KEY, signer_of
from roadgrip.certificates import RevocationList, Role, issue_revocations
from roadgrip.records import Reason, Rejected
from roadgrip.sections import read_section
from roadgrip.trust import credential_to_pem
from tests.rsu_app.fakes import make_passage
from tests.rsu_app.sites import passage_json
from tests.system.daemons import Daemon
from tests.system.fleets import Fleet
from vehicle_client.shell.keys import Keys, read_keys
from vehicle_client.shell.patience import Patience

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

SECTION = read_section("long-turn")
BRISK = Patience(reply_s=0.2, longest_s=0.4).stretched(60.0)
PSEUDONYMS_COUNT = 300
SETTINGS = """signatures = "required"

[clock]
speedup_ratio = 60.0

[signing]
credential_file = "unit.pem"
authorities_folder = "authorities"
revocations_file = "revoked.cose"
"""
certified_now = partial(
    signer_of, valid_from_unix_s=int(time.time()) - 3600, valid_until_unix_s=int(time.time()) + 86_400
)


def write_authority(path: Path, key: Ed25519PrivateKey) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    made: Path = tmp_path_factory.mktemp("signed")
    write_authority(made / "authorities" / "road.pem", AUTHORITY_KEY)
    write_authority(made / "other-authority.pem", OTHER_AUTHORITY_KEY)
    revoked = RevocationList(int(time.time()), int(time.time()) + 86_400, frozenset({b"stolen!!"}))
    (made / "revoked.cose").write_bytes(issue_revocations(revoked, authority=AUTHORITY_KEY))
    (made / "car").mkdir()
    for number in range(PSEUDONYMS_COUNT):
        # Many, since a unit counts passages by certificate.
        pseudonym = certified_now(Role.VEHICLE, certificate_id=number.to_bytes(8, "big"))
        (made / "car" / f"{number}.pem").write_bytes(credential_to_pem(pseudonym))
    for name, signer in {
        "unit": certified_now(Role.UNIT, section_ids=("long-turn",)),
        "stranger": certified_now(Role.VEHICLE, authority=OTHER_AUTHORITY_KEY),
        "stolen": certified_now(Role.VEHICLE, certificate_id=b"stolen!!"),
    }.items():
        (made / f"{name}.pem").write_bytes(credential_to_pem(signer))
    return made


def keys_of(folder: Path, name: str | None, *, authority: str = "authorities") -> Keys:
    place = folder / "car" if name == "car" else folder / f"{name}.pem"
    return read_keys([place] if name else [], [folder / authority])


@pytest.fixture(scope="module")
def daemon(folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROADGRIP_HTTP__SIGNATURES", "required")
        with Daemon(folder, SETTINGS) as running:
            yield running


@pytest.fixture(params=["udp", "http"])
def address(request, daemon) -> str:
    return daemon.url if request.param == "http" else f"udp://127.0.0.1:{daemon.udp_port}"


def test_a_signed_fleet_and_a_signed_unit_believe_each_other(daemon, folder, address, tmp_path):
    counted_before = daemon.window_count()
    fleet = Fleet(SECTION, 8, keys=keys_of(folder, "car"), seed=21 + len(address))
    report = asyncio.run(fleet.run(address, spool_folder=tmp_path))
    assert (report.accepted_count, report.counted_count, report.frames_ignored_count) == (8, 8, 0)
    assert all(ended.record.advisory is not None for ended in fleet.endings)
    assert daemon.window_count() == counted_before + 8
    assert set(report.passage_ids) <= {row.passage_id for row in daemon.stored()}


@pytest.mark.parametrize(
    "who",
    [(None, Reason.UNSIGNED), ("stranger", Reason.UNKNOWN_KEY), ("stolen", Reason.CERTIFICATE_REVOKED)],
)
def test_a_vehicle_that_the_unit_does_not_believe_is_told_why(daemon, folder, tmp_path, who):
    name, reason = who
    stored_before = daemon.stored()
    fleet = Fleet(SECTION, 2, keys=keys_of(folder, name), patience=BRISK, seed=22)
    report = asyncio.run(fleet.run(daemon.url, spool_folder=tmp_path))
    assert dict(report.rejected) == {reason.value: 2}
    outcomes = [ended.record.outcome for ended in fleet.endings]
    assert [outcome.reason for outcome in outcomes if isinstance(outcome, Rejected)] == [reason] * 2
    assert daemon.stored() == stored_before


@pytest.mark.parametrize("name", [None, "stranger", "stolen"])
def test_over_the_radio_a_vehicle_that_the_unit_does_not_believe_reports_nothing(daemon, folder, tmp_path, name):
    # A signed refusal is longer than an arrival, so an address that has not answered may not be sent one.
    stored_before = daemon.stored()
    fleet = Fleet(SECTION, 2, keys=keys_of(folder, name), patience=BRISK, seed=22)
    report = asyncio.run(fleet.run(f"udp://127.0.0.1:{daemon.udp_port}", spool_folder=tmp_path))
    assert report.accepted_count == 0
    assert daemon.stored() == stored_before


def test_a_vehicle_that_trusts_another_authority_ignores_the_unit(daemon, folder, address, tmp_path):
    stored_before = daemon.stored()
    fleet = Fleet(SECTION, 2, keys=keys_of(folder, "car", authority="other-authority.pem"), patience=BRISK, seed=23)
    report = asyncio.run(fleet.run(address, spool_folder=tmp_path))
    assert report.no_map_count == 2
    cookies_count = 0 if address.startswith("http") else 2
    assert report.frames_ignored_count == report.frames_received_count - cookies_count > 0
    assert [ended.record.advisory for ended in fleet.endings] == [None, None]
    assert fleet.maps == []
    assert daemon.stored() == stored_before


def test_where_signatures_are_required_json_is_no_way_around_them(daemon):
    body = passage_json(make_passage(SECTION, seed=24))
    answer = daemon.client.post("/v1/sections/long-turn/passages", json=body)
    assert (answer.status_code, answer.json()["reason"]) == (403, "unsigned")


def test_on_the_command_line_an_unsigned_vehicle_reads_one_line_with_the_reason(daemon, folder, tmp_path):
    arguments = ["--section", "rsu:long-turn", "--rsu", daemon.url]
    done = subprocess.run(
        [sys.executable, "-m", "vehicle_client", "fleet", *arguments, "--authority", str(folder / "authorities")],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "unsigned" in line
