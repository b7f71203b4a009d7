"""Whole fleets and a unit that sign what they say: who is believed, who is refused, and whether it learns why."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from roadgrip.records import Reason, Rejected
from roadgrip.sections import read_section
from tests.rsu_app.fakes import make_passage
from tests.rsu_app.sites import passage_json
from tests.system.daemons import Daemon
from tests.system.fleets import Fleet
from vehicle_client.shell.exchange import Patience
from vehicle_client.shell.keys import read_keys

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

SECTION = read_section("long-turn")
BRISK = Patience(reply_s=0.2, longest_s=0.4).stretched(60.0)
SIGNING = '[signing]\nkey_file = "unit.pem"\ntrusted_keys_folder = "trusted"\nrequired = true\n'


def write_key(private: Path, public: Path) -> None:
    key = Ed25519PrivateKey.generate()
    private.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    public.write_bytes(key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    made: Path = tmp_path_factory.mktemp("signed")
    (made / "trusted").mkdir()
    write_key(made / "unit.pem", made / "unit.pub")
    write_key(made / "car.pem", made / "trusted" / "car.pem")
    write_key(made / "stranger.pem", made / "stranger.pub")
    return made


@pytest.fixture(scope="module")
def daemon(folder):
    with Daemon(folder, f"[clock]\nspeedup_ratio = 60.0\n{SIGNING}") as running:
        yield running


@pytest.fixture(params=["udp", "http"])
def address(request, daemon) -> str:
    return daemon.url if request.param == "http" else f"udp://127.0.0.1:{daemon.udp_port}"


def test_a_signed_fleet_and_a_signed_unit_believe_each_other(daemon, folder, address, tmp_path):
    counted_before = daemon.window_count()
    fleet = Fleet(SECTION, 8, keys=read_keys(folder / "car.pem", [folder / "unit.pub"]), seed=21 + len(address))
    report = asyncio.run(fleet.run(address, spool_folder=tmp_path))
    assert (report.accepted_count, report.counted_count, report.frames_ignored_count) == (8, 8, 0)
    assert all(ended.record.advisory is not None for ended in fleet.endings)
    assert daemon.window_count() == counted_before + 8
    assert set(report.passage_ids) <= {row.passage_id for row in daemon.stored()}


@pytest.mark.parametrize("reason", [Reason.UNSIGNED, Reason.UNKNOWN_KEY])
def test_a_vehicle_that_the_unit_does_not_believe_is_told_why(daemon, folder, address, tmp_path, reason):
    stored_before = daemon.stored()
    keys = read_keys(None if reason is Reason.UNSIGNED else folder / "stranger.pem", [folder / "unit.pub"])
    fleet = Fleet(SECTION, 2, keys=keys, patience=BRISK, seed=22)
    report = asyncio.run(fleet.run(address, spool_folder=tmp_path))
    assert dict(report.rejected) == {reason.value: 2}
    outcomes = [ended.record.outcome for ended in fleet.endings]
    assert [outcome.reason for outcome in outcomes if isinstance(outcome, Rejected)] == [reason] * 2
    assert daemon.stored() == stored_before


def test_a_vehicle_that_trusts_another_key_ignores_the_unit(daemon, folder, address, tmp_path):
    stored_before = daemon.stored()
    fleet = Fleet(SECTION, 2, keys=read_keys(folder / "car.pem", [folder / "stranger.pub"]), patience=BRISK, seed=23)
    report = asyncio.run(fleet.run(address, spool_folder=tmp_path))
    assert report.no_map_count == 2
    assert report.frames_ignored_count == report.frames_received_count > 0
    assert [ended.record.advisory for ended in fleet.endings] == [None, None]
    assert fleet.maps == []
    assert daemon.stored() == stored_before


def test_where_signatures_are_required_json_is_no_way_around_them(daemon):
    body = passage_json(make_passage(SECTION, seed=24))
    answer = daemon.client.post("/v1/sections/long-turn/passages", json=body)
    assert (answer.status_code, answer.json()["reason"]) == (403, "unsigned")


def test_on_the_command_line_an_unsigned_vehicle_reads_one_line_with_the_reason(daemon, folder, tmp_path):
    arguments = ["--section", "rsu:long-turn", "--rsu", f"udp://127.0.0.1:{daemon.udp_port}"]
    done = subprocess.run(
        [sys.executable, "-m", "vehicle_client", "fleet", *arguments, "--trusted-key", str(folder / "unit.pub")],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "unsigned" in line
