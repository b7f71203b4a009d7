"""A clean Debian on this machine, in a folder: made once by debootstrap, copied for every story."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

RELEASE = "bookworm"
DEFAULT_MIRROR = "http://deb.debian.org/debian"
SOURCES = ("etc/apt/sources.list", "etc/apt/sources.list.d/debian.sources")
COMMAND_S = 900.0


def missing_for_a_root() -> str:
    """Return why no root can be made here; empty if one can."""
    if os.geteuid() != 0:
        return "a Debian root needs root"
    tools = [tool for tool in ("debootstrap", "unshare", "dpkg-deb", "systemd-analyze") if shutil.which(tool) is None]
    return f"missing: {', '.join(tools)} (apt-get install debootstrap dpkg systemd)" if tools else ""


def mirror() -> str:
    """Return where this machine has its packages from, if it is a Debian, or else where Debian has them."""
    for name in SOURCES:
        path = Path("/") / name
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        found = re.search(r"^(?:URIs:|deb(?: \[.*?\])?) *(\S+/debian/?)(\s|$)", text, re.MULTILINE)
        if found:
            return found[1].rstrip("/")
    return DEFAULT_MIRROR


def pristine_root(cache: Path) -> Path:
    """Return the root that nothing was installed into yet; it takes a minute when it is not there."""
    root = cache / f"{RELEASE}-root"
    whole = root / "etc" / "roadgrip-test-root-is-whole"
    if not whole.exists():
        shutil.rmtree(root, ignore_errors=True)
        cache.mkdir(parents=True, exist_ok=True)
        # What debootstrap mounts goes with its name space.
        _run("unshare", "--mount", "debootstrap", "--variant=minbase", RELEASE, str(root), mirror())
        in_root(root, "apt-get", "update")
        whole.touch()
    return root


def copied_root(pristine: Path, folder: Path) -> Path:
    """Return a copy that a story may change."""
    _run("cp", "-a", str(pristine), str(folder))
    return folder


def in_root(root: Path, *command: str, fails: bool = False) -> str:
    """Return what a command prints that runs inside a root as root."""
    shutil.copyfile("/etc/resolv.conf", root / "etc" / "resolv.conf")
    inside = 'mount -t proc proc "$0/proc"; mount --rbind /dev "$0/dev"; exec chroot "$0" "$@"'
    return _run(
        *("unshare", "--mount", "--propagation", "private", "sh", "-ec", inside, str(root), *command), fails=fails
    )


def _run(*command: str, fails: bool = False) -> str:
    environment = {
        **{name: value for name, value in os.environ.items() if name.lower().endswith("_proxy")},
        "PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
        "HOME": "/root",
        "LC_ALL": "C.UTF-8",
        "DEBIAN_FRONTEND": "noninteractive",
    }
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=COMMAND_S, check=False, cwd="/"
    )
    assert fails or done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout + (done.stderr if fails else "")
