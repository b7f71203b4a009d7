"""The life of the Debian package in a clean Debian root: installed, run as its unit runs it, upgraded, removed, purged.

One story, told once (`make deb-test`; it takes minutes), and what is asked about it afterwards.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import httpx
import pytest

from deploy.debian.build import PROCESSORS, build
from roadgrip.sections import read_section
from tests.packaging.debian_root import copied_root, in_root, missing_for_a_root, pristine_root
from tests.rsu_app.fakes import make_passage
from tests.rsu_app.sites import passage_json

pytestmark = [
    pytest.mark.long,
    pytest.mark.system,
    pytest.mark.xdist_group("packaging"),
    pytest.mark.timeout(3_600),
    pytest.mark.skipif(missing_for_a_root() != "", reason=missing_for_a_root() or "a root can be made"),
]

START_S = 60.0
WATCHDOG_S = 2.0
INSTALL_LIMIT_MB = 250.0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class Life:
    """What was seen on the way."""

    root: Path
    port: int = 0
    seen: dict[str, Any] = field(default_factory=dict)

    def stat_of(self, path: str) -> tuple[int, str, str]:
        """Return mode, owner and group of a path inside."""
        mode, owner, group = in_root(self.root, "stat", "-c", "%a %U %G", path).split()
        return int(mode, 8), owner, group

    def names(self) -> list[str]:
        """Return everything inside that has our name, but what dpkg and apt write about the past."""
        told = in_root(
            self.root,
            "find",
            "/",
            "-xdev",
            "-name",
            "*roadgrip*",
            "-not",
            "-path",
            "/proc/*",
            "-not",
            "-path",
            "/dev/*",
        )
        return [name for name in told.split() if not name.startswith(("/var/cache/", "/srv/", "/etc/roadgrip-test"))]

    @contextmanager
    def running(self) -> Iterator[Daemon]:
        with Daemon(self) as daemon:
            yield daemon


class Daemon:
    """The unit's own command line, confined as its unit says, while the context lasts."""

    def __init__(self, life: Life) -> None:
        self._root = life.root
        self.url = f"http://127.0.0.1:{life.port}"
        self.said: list[str] = []

    def __enter__(self) -> Self:
        address = self._root / "run" / "notify"
        address.unlink(missing_ok=True)
        self._manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._manager.bind(str(address))
        address.chmod(0o777)
        self._log = (self._root.parent / "daemon.log").open("w+b")
        unit = self._root / "lib/systemd/system/roadgrip-rsu.service"
        confinement = Path(__file__).with_name("confinement.py")
        self.process = subprocess.Popen(
            ["unshare", "--mount", "--propagation", "private", sys.executable, str(confinement), unit, self._root],
            env={**os.environ, "NOTIFY_SOCKET": "/run/notify", "WATCHDOG_USEC": str(int(WATCHDOG_S * 1e6))},
            stdout=self._log,
            stderr=subprocess.STDOUT,
        )
        self.wait_for("READY=1")
        return self

    def wait_for(self, word: str) -> None:
        """Return once systemd would have been told something."""
        give_up_s = time.monotonic() + START_S
        self._manager.settimeout(1.0)
        while word not in self.said:
            assert self.process.poll() is None, f"ended with {self.process.returncode}\n{self.log()}"
            assert time.monotonic() < give_up_s, f"no {word} in {START_S} s: {self.said}\n{self.log()}"
            try:
                self.said += self._manager.recv(4_096).decode().split("\n")
            except TimeoutError:
                continue

    def log(self) -> str:
        self._log.seek(0)
        return self._log.read().decode()

    def status(self) -> dict[str, str]:
        text = Path(f"/proc/{self.process.pid}/status").read_text(encoding="utf-8")
        return dict(line.split(":\t", 1) for line in text.splitlines() if ":\t" in line)

    def stop(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(timeout=30)

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._manager.close()
        self._log.close()


def test_the_life_of_the_package(life):
    """Holds the story itself: were a step to fail, it would fail here."""
    assert life.seen["steps"] == ["installed", "ran", "upgraded", "ran again", "restored", "removed", "purged"]


@pytest.fixture(scope="module")
def life(project_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Life:
    work = project_root / "build" / "deb-test"
    shutil.rmtree(work, ignore_errors=True)
    (processor,) = (each for each in PROCESSORS if each.machine == os.uname().machine)
    packages = [
        build(processor, revision=revision, out=work / "packages", work=work / "package-tree")
        for revision in ("1", "2")
    ]
    pristine = pristine_root(project_root / "build" / "debian")
    story = Life(copied_root(pristine, work / "root"), port=free_port())
    for package in packages:
        shutil.copyfile(package, story.root / "srv" / package.name)
    story.seen["packages"] = packages
    story.seen["steps"] = []
    before_bytes = disk_bytes(story.root)
    install(story, packages[0])
    story.seen["installed_mb"] = (disk_bytes(story.root) - before_bytes) / 1e6
    look_around(story)
    run_for_the_first_time(story)
    install(story, packages[1])
    story.seen["steps"].append("upgraded")
    run_again(story)
    restore(story)
    part(story)
    results = project_root / "docs" / "results" / "debian.json"
    results.write_text(json.dumps(story.seen["results"], indent=1) + "\n", encoding="utf-8")
    return story


def install(story: Life, package: Path) -> None:
    said = in_root(
        story.root, "apt-get", "install", "--yes", "--no-install-recommends", f"/srv/{package.name}", fails=True
    )
    story.seen[f"said {package.name}"] = said
    assert re.search(r"Setting up roadgrip-rsu", said), said


def disk_bytes(root: Path) -> int:
    told = subprocess.run(
        ["du", "--summarize", "--block-size=1", "--one-file-system", "--exclude=var/cache", "--exclude=srv", "."],
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
    )
    return int(told.stdout.split()[0])


def look_around(story: Life) -> None:
    seen = story.seen
    seen["steps"].append("installed")
    seen["verified"] = in_root(story.root, "dpkg", "--verify", "roadgrip-rsu")
    wanted = story.root / "etc/systemd/system/multi-user.target.wants/roadgrip-rsu.service"
    seen["enabled"] = str(wanted.readlink())
    seen["own_mb"] = int(in_root(story.root, "dpkg-query", "-W", "-f", "${Installed-Size}", "roadgrip-rsu")) * 1.024e-3
    seen["account"] = in_root(story.root, "getent", "passwd", "roadgrip").strip().split(":")
    seen["modes"] = {
        path: story.stat_of(path)
        for path in (
            *("/etc/roadgrip", "/etc/roadgrip/keys", "/etc/roadgrip/sections", "/etc/roadgrip/rsu.toml"),
            *("/var/lib/roadgrip", "/usr/lib/roadgrip", "/usr/bin/roadgrip-rsu"),
        )
    }
    seen["version"] = in_root(story.root, "roadgrip-rsu", "--version")
    seen["checked"] = in_root(story.root, "roadgrip-rsu", "config", "check")
    seen["foreign"] = in_root(story.root, "find", "/usr/lib/roadgrip", "/var/lib/roadgrip", "-not", "-user", "root")
    # As an operator does.
    config = story.root / "etc/roadgrip/rsu.toml"
    text = config.read_text(encoding="utf-8").replace("port = 8080", f"port = {story.port}")
    config.write_text(text.replace("port = 4740", "port = 0"), encoding="utf-8")


def run_for_the_first_time(story: Life) -> None:
    seen, section = story.seen, read_section("long-turn")
    began_s = time.monotonic()
    with story.running() as daemon, httpx.Client(base_url=daemon.url, timeout=30.0) as client:
        ready_s = time.monotonic() - began_s
        seen["ready"] = client.get("/health/ready")
        seen["receipt"] = client.post(
            "/v1/sections/long-turn/passages", json=passage_json(make_passage(section, seed=1))
        )
        daemon.wait_for("WATCHDOG=1")
        seen["process"] = daemon.status()
        seen["backup"] = in_root(story.root, "roadgrip-rsu", "backup", "/srv/backup.tar.gz")
        seen["refused"] = in_root(story.root, "roadgrip-rsu", "restore", "/srv/backup.tar.gz", fails=True)
        seen["status"] = json.loads(in_root(story.root, "roadgrip-rsu", "status", "--json"))
        resident_mb = int(daemon.status()["VmRSS"].split()[0]) / 1e3
        seen["exit code"] = daemon.stop()
        seen["log"] = daemon.log()
    seen["steps"].append("ran")
    seen["results"] = {
        "package_mb": round(seen["packages"][0].stat().st_size / 1e6, 1),
        "install_mb": round(seen["own_mb"], 1),
        "disk_with_all_dependencies_mb": round(seen["installed_mb"], 1),
        "rss_mb": round(resident_mb, 1),
        "ready_s": round(ready_s, 1),
        "conditions": f"Debian root {os.uname().machine}, confined as the unit says, other work on the machine",
    }


def run_again(story: Life) -> None:
    story.seen["settings kept"] = f"port = {story.port}" in (story.root / "etc/roadgrip/rsu.toml").read_text("utf-8")
    story.seen["new version"] = in_root(story.root, "dpkg-query", "-W", "-f", "${Version}", "roadgrip-rsu")
    with story.running() as daemon, httpx.Client(base_url=daemon.url, timeout=30.0) as client:
        metrics = client.get("/metrics").text
        story.seen["remembered"] = re.findall(r"^roadgrip_store_passages (\S+)", metrics, re.MULTILINE)
        body = passage_json(make_passage(read_section("long-turn"), seed=2))
        story.seen["second receipt"] = client.post("/v1/sections/long-turn/passages", json=body)
        daemon.stop()
    story.seen["steps"].append("ran again")


def restore(story: Life) -> None:
    story.seen["restored"] = in_root(story.root, "roadgrip-rsu", "restore", "/srv/backup.tar.gz", "--by", "ann")
    story.seen["restored owners"] = set(in_root(story.root, "find", "/var/lib/roadgrip", "-printf", "%u:%g\\n").split())
    story.seen["restored check"] = in_root(story.root, "roadgrip-rsu", "db", "check")
    story.seen["steps"].append("restored")


def part(story: Life) -> None:
    seen = story.seen
    in_root(story.root, "apt-get", "remove", "--yes", "roadgrip-rsu")
    seen["steps"].append("removed")
    seen["names after removal"] = story.names()
    seen["account after removal"] = in_root(story.root, "getent", "passwd", "roadgrip")
    (story.root / "etc/roadgrip/keys/unit.pem").write_text("a key of the operator's")
    in_root(story.root, "apt-get", "purge", "--yes", "roadgrip-rsu")
    seen["steps"].append("purged")
    seen["names after purge"] = story.names()
    seen["account after purge"] = in_root(story.root, "getent", "passwd", "roadgrip", fails=True)


def test_it_brings_an_account_that_nobody_logs_in_with(life):
    assert life.seen["account"][-2:] == ["/var/lib/roadgrip", "/usr/sbin/nologin"]


def test_folders_belong_to_whom_they_should(life):
    assert life.seen["modes"] == {
        "/etc/roadgrip": (0o755, "root", "root"),
        "/etc/roadgrip/keys": (0o750, "root", "roadgrip"),
        "/etc/roadgrip/sections": (0o755, "root", "root"),
        "/etc/roadgrip/rsu.toml": (0o644, "root", "root"),
        "/var/lib/roadgrip": (0o750, "roadgrip", "roadgrip"),
        "/usr/lib/roadgrip": (0o755, "root", "root"),
        "/usr/bin/roadgrip-rsu": (0o755, "root", "root"),
    }


def test_it_is_enabled_for_the_next_start_of_the_machine(life):
    assert life.seen["enabled"] == "/lib/systemd/system/roadgrip-rsu.service"


def test_every_file_is_as_it_was_packed_also_after_it_was_run_by_root(life):
    assert life.seen["verified"] == ""
    assert life.seen["foreign"].split() == ["/var/lib/roadgrip"]


def test_an_operator_asks_without_naming_the_settings(life):
    assert re.fullmatch(r"roadgrip \d+\.\d+\.\d+\S*\n", life.seen["version"])
    assert "/var/lib/roadgrip/rsu.sqlite3" in life.seen["checked"]


def test_the_units_own_command_line_runs_under_the_units_own_restrictions(life):
    assert life.seen["ready"].status_code == 200, life.seen["ready"].text
    process = life.seen["process"]
    assert process["NoNewPrivs"] == "1"
    assert process["Seccomp"] == "2"
    assert {process[name] for name in ("CapEff", "CapPrm", "CapBnd")} == {"0" * 16}
    assert process["Uid"].split()[0] == life.seen["account"][2]
    assert life.seen["exit code"] == 0


def test_it_takes_a_passage_and_its_log_knows_no_error(life):
    assert life.seen["receipt"].json()["outcome"] == "accepted", life.seen["receipt"].text
    levels = {json.loads(line)["level"] for line in life.seen["log"].splitlines()}
    assert levels <= {"info", "debug"}, life.seen["log"]


def test_an_operator_backs_it_up_and_asks_how_it_is_while_it_runs(life):
    assert life.seen["backup"].startswith("written: /srv/backup.tar.gz")
    assert "stop it first" in life.seen["refused"]
    assert life.seen["status"]["ready"] is True


def test_an_upgrade_keeps_passages_and_settings(life):
    assert life.seen["new version"].endswith("-2")
    assert life.seen["settings kept"]
    assert life.seen["remembered"] == ["1.0"]
    assert life.seen["second receipt"].json()["outcome"] == "accepted"


def test_what_root_restores_belongs_to_the_unit(life):
    assert life.seen["restored"].startswith("restored: ")
    assert life.seen["restored owners"] == {"roadgrip:roadgrip"}
    assert "sound" in life.seen["restored check"]


def test_removing_keeps_what_the_unit_knows_and_was_told(life):
    names = life.seen["names after removal"]
    assert {"/var/lib/roadgrip", "/etc/roadgrip"} <= set(names)
    assert "/usr/lib/roadgrip" not in names
    assert "/usr/bin/roadgrip-rsu" not in names
    assert life.seen["account after removal"]


def test_purging_leaves_nothing(life):
    assert life.seen["names after purge"] == []
    assert life.seen["account after purge"] == ""


def test_it_fits(life):
    assert life.seen["results"]["install_mb"] <= INSTALL_LIMIT_MB
