from __future__ import annotations

from dataclasses import replace

import pytest

from rsu_app.doctor.findings import Level
from rsu_app.doctor.seen import (
    BundleSeen,
    DatabaseSeen,
    PortSeen,
    PortState,
    RepositorySeen,
    SectionsSeen,
    SettingsSeen,
    TrustSeen,
    UnitSeen,
)
from rsu_app.doctor.unit_checks import (
    bundle_finding,
    database_finding,
    port_finding,
    repository_finding,
    sections_finding,
    settings_finding,
    traffic_finding,
    trust_finding,
    unit_findings,
)
from rsu_app.rollout_ports import UpdateReason
from tests.rsu_app.fakes import NOON_UNIX_S

DAY_S = 86_400.0
DATABASE = DatabaseSeen(
    "/v/rsu.sqlite3",
    exists=True,
    size_bytes=10_000_000,
    log_bytes=4_000_000,
    newest_received_unix_s=NOON_UNIX_S - 60.0,
    account="roadgrip",
    owner="roadgrip",
    folder_owner="roadgrip",
)
REPOSITORY = RepositorySeen(
    "https://models.example.org", rooted=True, ring="all", visited=True, expires_unix_s=NOON_UNIX_S + 40 * DAY_S
)
PORT = PortSeen("http", "127.0.0.1", 8080, PortState.FREE, loopback=True, ours=False)
RADIO = PortSeen("udp", "192.0.2.7", 4740, PortState.TAKEN, loopback=False, ours=True, protected=True)
TRUST = TrustSeen(signs=True, believes=True, signature_ends_unix_s=NOON_UNIX_S + 200 * DAY_S)
UNIT = UnitSeen("/v/control.sock", runs=True, committed_ago_s=3.0)


def trust(**changes: object):
    return trust_finding(replace(TRUST, **changes), now_unix_s=NOON_UNIX_S)  # type: ignore[arg-type] # any field of it


def repository(**changes: object):
    return repository_finding(replace(REPOSITORY, **changes), now_unix_s=NOON_UNIX_S)  # type: ignore[arg-type] # same


def traffic(newest_unix_s: float | None):
    return traffic_finding(replace(DATABASE, newest_received_unix_s=newest_unix_s), now_unix_s=NOON_UNIX_S)


WELL = [
    settings_finding(SettingsSeen("/etc/roadgrip/rsu.toml")),
    sections_finding(SectionsSeen(("long-turn",))),
    bundle_finding(BundleSeen("5f2c")),
    repository(),
    repository(source=""),
    repository(visited=False, expires_unix_s=None),
    database_finding(DATABASE),
    database_finding(replace(DATABASE, exists=False)),
    traffic(NOON_UNIX_S - 60.0),
    port_finding(PORT),
    port_finding(RADIO),
    trust(),
    trust(signs=False, believes=False, signature_ends_unix_s=None),
    *unit_findings(UNIT),
    *unit_findings(replace(UNIT, committed_ago_s=90_000.0)),
]


@pytest.mark.parametrize("finding", WELL, ids=lambda finding: str(finding.name))
def test_what_is_well_needs_no_remedy(finding):
    assert (finding.level, finding.remedy) == (Level.OK, "")
    assert finding.seen


def only(findings, level: Level):
    (found,) = [finding for finding in findings if finding.level is level]
    return found


ILL = [
    (settings_finding(SettingsSeen("f", "http.port: too large")), "fail", "http.port", "config check"),
    (sections_finding(SectionsSeen(problem="bend: too many nodes")), "fail", "nodes", "section check"),
    (bundle_finding(BundleSeen(problem="no manifest")), "fail", "no manifest", "model.bundle_path"),
    (bundle_finding(BundleSeen("5f2c", notes=("bundle 9 cannot be used",))), "warn", "bundle 9", "update"),
    (repository(rooted=False), "warn", "nobody is trusted", "updates.trusted_root"),
    (repository(problem="expired: x", reason="expired"), "warn", "expired", "roadgrip-train refresh"),
    (repository(problem="tampered: x", reason="tampered"), "warn", "tampered", "docs/operators.md"),
    (repository(expires_unix_s=NOON_UNIX_S + 3 * DAY_S), "warn", "2026-01-04", "roadgrip-train refresh"),
    (database_finding(replace(DATABASE, writable=False)), "fail", "cannot be written by roadgrip", "chown"),
    (database_finding(replace(DATABASE, owner="root")), "fail", "belongs to root", "chown roadgrip"),
    (database_finding(replace(DATABASE, problems=("row 7 missing",))), "fail", "row 7", "restore"),
    (database_finding(replace(DATABASE, damaged=("rsu.sqlite3.damaged-1",))), "warn", "damaged-1", "delete"),
    (database_finding(replace(DATABASE, log_bytes=200_000_000)), "warn", "log 191 MB", "lsof"),
    (database_finding(replace(DATABASE, others_may_read=True)), "warn", "every account", "chmod"),
    (traffic(None), "warn", "none is stored", "udp.host"),
    (traffic(NOON_UNIX_S - 3 * DAY_S), "warn", "3 d 0 h ago", "radio"),
    (port_finding(replace(PORT, state=PortState.TAKEN)), "fail", "another program", "ss -lunpt"),
    (port_finding(replace(PORT, state=PortState.NO_ADDRESS)), "fail", "no address", "http.host"),
    (port_finding(replace(PORT, state=PortState.FORBIDDEN, port=80)), "fail", "may not", "1023"),
    (port_finding(replace(PORT, ours=True)), "fail", "nobody listens", "anew"),
    (port_finding(replace(RADIO, host="127.0.0.1", loopback=True)), "warn", "only this machine", "udp.host"),
    (port_finding(replace(RADIO, protected=False)), "warn", "strangers", "security.md"),
    (port_finding(replace(PORT, host="192.0.2.7", loopback=False)), "warn", "strangers", "tls_certificate_file"),
    (trust(problem="signing.credential_file: cannot read"), "fail", "cannot read", "setting"),
    (trust(exposed=("/etc/roadgrip/unit.pem",)), "fail", "unit.pem", "chmod 640"),
    (trust(signature_ends_unix_s=NOON_UNIX_S - 1.0), "fail", "ended 2026-01-01", "issue"),
    (trust(tls=True, tls_ends_unix_s=NOON_UNIX_S + 9 * DAY_S), "warn", "HTTPS ends 2026-01-10", "issue"),
    (trust(warnings=("the list is overdue",)), "warn", "overdue", "security.md"),
    (only(unit_findings(replace(UNIT, problem="timed out")), Level.FAIL), "fail", "timed out", "sudo -u"),
    (only(unit_findings(UnitSeen("/v/c", runs=False)), Level.WARN), "warn", "none runs", "systemctl start"),
    (only(unit_findings(replace(UNIT, unmet=("clock: 1970",))), Level.FAIL), "fail", "clock: 1970", "status"),
    (only(unit_findings(replace(UNIT, others_may_order=True)), Level.FAIL), "fail", "control.sock", "chmod 600"),
    (only(unit_findings(replace(UNIT, committed_ago_s=None)), Level.WARN), "warn", "failed", "disk"),
]


@pytest.mark.parametrize(("finding", "level", "seen", "remedy"), ILL, ids=lambda part: getattr(part, "name", None))
def test_what_is_ill_says_what_was_seen_and_what_mends_it(finding, level, seen, remedy):
    assert finding.level.value == level
    assert seen in finding.seen
    assert remedy in finding.remedy


@pytest.mark.parametrize("reason", UpdateReason)
def test_every_reason_for_taking_no_release_has_a_remedy(reason):
    assert repository(problem=f"{reason.value}: x", reason=reason.value).remedy


def test_a_unit_on_a_port_that_the_machine_chose_is_not_looked_for():
    assert port_finding(replace(PORT, port=0, ours=True)).level is Level.OK
