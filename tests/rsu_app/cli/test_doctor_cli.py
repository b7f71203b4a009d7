from __future__ import annotations

import io
import json

from rich.console import Console
from typer.testing import CliRunner

import rsu_app.cli.main as program
from rsu_app.cli.doctor import findings_table
from rsu_app.doctor.findings import failed, fine, warned
from tests.bundles import make_bundle


def test_findings_are_shown_in_80_columns_with_the_remedy_below():
    out = io.StringIO()
    findings = [
        fine("settings", "/etc/roadgrip/rsu.toml"),
        warned("udp buffer", "208 kB granted of 4.0 MB", "sysctl -w net.core.rmem_max=4194304"),
        failed("clock", "it says 120 s since 1970, before 2024", "timedatectl set-ntp true"),
    ]
    Console(file=out, width=80, no_color=True).print(findings_table(findings))
    assert [line.rstrip() for line in out.getvalue().splitlines()] == [
        "ok    settings    /etc/roadgrip/rsu.toml",
        "warn  udp buffer  208 kB granted of 4.0 MB",
        "                  -> sysctl -w net.core.rmem_max=4194304",
        "FAIL  clock       it says 120 s since 1970, before 2024",
        "                  -> timedatectl set-ntp true",
    ]


def test_a_machine_gets_the_findings_of_a_unit_that_does_not_run(tmp_path):
    make_bundle(tmp_path / "bundle")
    config = tmp_path / "rsu.toml"
    config.write_text('[database]\npath = "rsu.sqlite3"\n[model]\nbundle_path = "bundle"\n[udp]\nport = 0\n')
    words = ["doctor", "--json", "--offline", "--config", str(config), "--backups", str(tmp_path)]
    result = CliRunner().invoke(program.app, words)
    findings = {finding["name"]: finding for finding in json.loads(result.stdout)}
    assert findings["unit"]["level"] == "warn"
    assert findings["bundle"]["level"] == "ok"
    assert findings["backup"]["level"] == "ok"
    assert result.exit_code == max({"ok": 0, "warn": 1, "fail": 2}[each["level"]] for each in findings.values())
