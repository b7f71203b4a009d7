"""What `deploy/` brings a unit, as far as it can be judged without installing it."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tomllib
from email.parser import Parser
from pathlib import Path
from typing import Any

import pytest

from deploy.debian.bill import RESULTS, TABLE_NAME, bill_table
from deploy.debian.build import (
    FILES,
    NEXT_PYTHON,
    PROCESSORS,
    PYTHON,
    SCRIPTS,
    BuildError,
    debian_version,
    refuse_gaps,
)
from rsu_app.settings import Settings, load_settings
from tests.packaging.confinement import settings_of
from training.marked_tables import with_tables

INSTALL_LIMIT_MB = 250.0
EXPOSURE_LIMIT = 20
"""Tenths of what `systemd-analyze security` shows."""
needs_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd-analyze here")


@pytest.fixture
def unit(project_root: Path) -> Path:
    return project_root / "deploy" / "systemd" / "roadgrip-rsu.service"


# The unit ------------------------------------------------------------------------------------------------------------


@needs_systemd
def test_systemd_finds_nothing_wrong_with_the_unit(unit, tmp_path):
    # Its program is not installed here; any other that is will do.
    copy = tmp_path / unit.name
    copy.write_text(unit.read_text(encoding="utf-8").replace("/usr/lib/roadgrip/bin/python", "/bin/true"))
    done = subprocess.run(["systemd-analyze", "verify", str(copy)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


@needs_systemd
def test_little_is_exposed(unit):
    command = ["systemd-analyze", "security", "--offline=true", f"--threshold={EXPOSURE_LIMIT}", str(unit)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_the_watchdog_has_someone_to_listen_to(unit):
    settings = settings_of(unit)
    assert settings["Type"] == ["notify"]
    assert float(settings["WatchdogSec"][0]) >= 10.0


def test_memory_processor_and_log_are_limited(unit):
    settings = settings_of(unit)
    assert {"MemoryMax", "CPUQuota", "TasksMax", "LogRateLimitBurst", "LogRateLimitIntervalSec"} <= settings.keys()


def test_stopping_is_given_more_time_than_the_unit_takes(unit):
    assert float(settings_of(unit)["TimeoutStopSec"][0]) > 2 * Settings().http.shutdown_s


# The package ---------------------------------------------------------------------------------------------------------


def test_the_control_file_holds_what_dpkg_and_a_person_need():
    text = (FILES / "control").read_text(encoding="utf-8")
    control = Parser().parsestr(
        text.format(
            version="0.1.0-1", architecture="arm64", installed_size_kb=1, python=PYTHON, next_python=NEXT_PYTHON
        )
    )
    assert {"Package", "Version", "Architecture", "Maintainer", "Installed-Size", "Depends", "Description"} <= set(
        control.keys()
    )
    assert f"python3 (>= {PYTHON}~), python3 (<< {NEXT_PYTHON}~)" in control["Depends"]
    assert "\n\n" not in text


@pytest.mark.parametrize(
    ("version", "revision", "known_as"),
    [
        ("0.1.0", "1", "0.1.0-1"),
        ("1.0rc1", "2", "1.0~rc1-2"),
        ("1.0.dev3", "1", "1.0~dev3-1"),
        ("1.0b2", "1+site1", "1.0~b2-1+site1"),
    ],
)
def test_what_comes_before_a_release_is_older_than_it(version, revision, known_as):
    assert debian_version(version, revision=revision) == known_as


@pytest.mark.parametrize("name", [*SCRIPTS, "roadgrip-rsu"])
def test_shell_scripts_are_sound(name):
    script = FILES / name
    subprocess.run(["sh", "-n", str(script)], check=True)
    if shutil.which("shellcheck"):
        subprocess.run(["shellcheck", "--shell=sh", str(script)], check=True)
    assert script.read_text(encoding="utf-8").startswith("#!/bin/sh\n")


def test_its_settings_are_the_defaults_but_for_the_place_of_the_database(tmp_path, monkeypatch):
    for name in [name for name in os.environ if name.startswith("ROADGRIP_")]:
        monkeypatch.delenv(name)
    chosen, usual = load_settings(FILES / "rsu.toml"), Settings()
    assert chosen.database.path == Path("/var/lib/roadgrip/rsu.sqlite3")
    assert chosen.model_copy(update={"database": usual.database}) == usual


def test_the_unit_the_scripts_and_the_settings_name_the_same_places(unit):
    settings = settings_of(unit)
    state = f"/var/lib/{settings['StateDirectory'][0]}"
    database = tomllib.loads((FILES / "rsu.toml").read_text(encoding="utf-8"))["database"]["path"]
    assert Path(database).parent == Path(state) == Path(settings["WorkingDirectory"][0])
    for name in ("postinst", "postrm"):
        assert state in (FILES / name).read_text(encoding="utf-8")
    command = settings["ExecStart"][0].split()
    assert command[0] in (FILES / "roadgrip-rsu").read_text(encoding="utf-8")
    assert settings["User"][0] in (FILES / "postinst").read_text(encoding="utf-8")
    assert settings["StateDirectoryMode"] == ["0750"]


def test_the_lock_knows_wheels_of_both_processors(project_root):
    # A wheel has a hash of its own for each; a distribution with a single one is the same for all.
    lock = (project_root / "requirements" / "rsu.txt").read_text(encoding="utf-8")
    blocks = re.split(r"^(?=[a-z0-9-]+==)", lock, flags=re.MULTILINE)
    hashes_count = {block.split("==")[0]: block.count("--hash=") for block in blocks}
    assert len(PROCESSORS) == 2
    assert hashes_count["onnxruntime"] >= len(PROCESSORS)


def test_a_lock_that_is_older_than_what_is_asked_for_is_found_before_the_package_is_made(tmp_path):
    for name, requires in (
        ("roadgrip", "Requires-Dist: numpy>=2\nRequires-Dist: uvicorn; extra == 'rsu'\n"),
        ("numpy", ""),
    ):
        folder = tmp_path / f"{name}-1.0.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n{requires}", encoding="utf-8"
        )
    with pytest.raises(BuildError, match="uvicorn"):
        refuse_gaps(tmp_path)
    (tmp_path / "uvicorn-1.0.dist-info").mkdir()
    (tmp_path / "uvicorn-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: uvicorn\nVersion: 1.0\n")
    refuse_gaps(tmp_path)


# Containers ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def compose(project_root: Path) -> dict[str, Any]:
    yaml = pytest.importorskip("yaml", reason="no YAML reader is installed")
    text = (project_root / "deploy" / "container" / "compose.yaml").read_text(encoding="utf-8")
    loaded: dict[str, Any] = yaml.safe_load(text)
    return loaded


def test_the_container_runs_without_rights_on_a_file_system_that_it_cannot_change(compose, project_root):
    service = compose["services"]["rsu"]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    text = (project_root / "deploy" / "container" / "Containerfile").read_text(encoding="utf-8")
    assert f"USER {service['user']}\n" in text
    assert service["user"].split(":")[0] in re.findall(r"--uid (\d+)", text)
    assert "HEALTHCHECK" in text


def test_the_container_is_limited_like_the_unit(compose, unit):
    service, settings = compose["services"]["rsu"], settings_of(unit)
    assert service["mem_limit"].upper() == settings["MemoryMax"][0]
    assert f"{service['cpus']:.0%}" == settings["CPUQuota"][0]
    assert str(service["pids_limit"]) == settings["TasksMax"][0]
    assert str(service["ulimits"]["nofile"]) == settings["LimitNOFILE"][0]


def test_what_the_container_keeps_lies_in_its_volume(compose, project_root):
    service = compose["services"]["rsu"]
    (volume,) = [each for each in service["volumes"] if each.split(":")[0] in compose["volumes"]]
    settings = load_settings(project_root / "deploy" / "container" / "rsu.toml")
    assert str(settings.database.path.parent) == volume.split(":")[1]
    published = {each.rsplit(":", 1)[1] for each in service["ports"]}
    assert published == {f"{settings.http.port}/tcp", f"{settings.udp.port}/udp"}


# The bill ------------------------------------------------------------------------------------------------------------


def test_the_page_tells_what_the_packages_were_found_to_weigh(project_root):
    bills = json.loads(RESULTS.read_text(encoding="utf-8"))
    page = (project_root / "docs" / "install.md").read_text(encoding="utf-8")
    assert with_tables(page, {TABLE_NAME: bill_table(bills)}.get) == page, "make deb-bill"
    assert all(bill["install_mb"] <= INSTALL_LIMIT_MB for bill in bills)
