"""Starts the command line of a systemd unit inside a Debian root, confined as its unit says, without systemd.

Emulated are account, capabilities, resource limits, the read-only file system, private places, no writable code,
address families, and system calls. A call that the unit does not allow ends the process: none goes unnoticed.

    unshare --mount --propagation private python confinement.py UNIT ROOT

Not emulated: control groups (memory, processor, tasks), PrivateUsers, Restrict* beyond address families, the journal.
"""

from __future__ import annotations

import ctypes
import os
import re
import resource
import shlex
import socket
import subprocess
import sys
from pathlib import Path

NO_NEW_PRIVILEGES, DROP_BOUNDING, MEMORY_DENY_WRITE_EXECUTE = 38, 24, 65
KILL_PROCESS, ALLOW, NOT_PERMITTED = 0x8000_0000, 0x7FFF_0000, 0x0005_0001
EQUAL = 4
REFUSED_IN_VAIN = ("mbind",)
"""Asked for, refused with the error of the unit, and not missed: OpenBLAS would have its memory near a processor."""
CAPABILITIES_COUNT = 41


class _Argument(ctypes.Structure):
    """`struct scmp_arg_cmp` of libseccomp."""

    _fields_ = (("number", ctypes.c_uint), ("how", ctypes.c_int), ("a", ctypes.c_uint64), ("b", ctypes.c_uint64))


def settings_of(unit: Path) -> dict[str, list[str]]:
    """Return the settings of a unit's [Service]; those given more than once in their order."""
    found: dict[str, list[str]] = {}
    text = unit.read_text(encoding="utf-8").replace("\\\n", " ")
    for name, value in re.findall(r"^(\w+)=(.*)$", text.split("[Service]")[1].split("[Install]")[0], re.MULTILINE):
        found.setdefault(name, []).append(value)
    return found


def members_of(group: str) -> set[str]:
    """Return the system calls of a group such as @system-service; a call is a group of itself."""
    if not group.startswith("@"):
        return {group}
    told = subprocess.run(["systemd-analyze", "syscall-filter", group], capture_output=True, text=True, check=True)
    lines = [line.strip() for line in told.stdout.splitlines() if line.startswith("    ")]
    return {name for line in lines if not line.startswith("#") for name in members_of(line)}


def allowed_calls(settings: dict[str, list[str]]) -> set[str]:
    """Return the system calls that a unit allows."""
    allowed: set[str] = set()
    for line in settings["SystemCallFilter"]:
        names = {name for group in line.lstrip("~").split() for name in members_of(group)}
        allowed = allowed - names if line.startswith("~") else allowed | names
    return allowed


def account_of(root: Path, name: str) -> tuple[int, int]:
    for line in (root / "etc/passwd").read_text(encoding="utf-8").splitlines():
        if line.startswith(f"{name}:"):
            user, group = line.split(":")[2:4]
            return int(user), int(group)
    raise SystemExit(f"{root} has no account {name}")


def arrange(root: Path, settings: dict[str, list[str]]) -> None:
    """Make the mounts of ProtectSystem=strict, ProtectHome, PrivateTmp and PrivateDevices, in this process's view."""
    state = root / "var/lib" / settings["StateDirectory"][0]

    def mount(*words: str | Path) -> None:
        subprocess.run(["mount", *map(str, words)], check=True)

    mount("--bind", root, root)
    mount("--bind", state, state)
    mount("--bind", root / "run", root / "run")
    mount("-o", "remount,bind,ro", root, root)
    mount("-t", "proc", "-o", "hidepid=invisible", "proc", root / "proc")
    mount("-t", "tmpfs", "-o", "mode=1777", "tmpfs", root / "tmp")
    for place in ("home", "root"):
        mount("-t", "tmpfs", "-o", "mode=000,ro", "tmpfs", root / place)
    mount("-t", "tmpfs", "-o", "mode=755", "tmpfs", root / "dev")
    for name, number in (("null", 3), ("zero", 5), ("full", 7), ("random", 8), ("urandom", 9)):
        os.mknod(root / "dev" / name, 0o20666, os.makedev(1, number))
        (root / "dev" / name).chmod(0o666)


def confine(settings: dict[str, list[str]], calls: set[str], seccomp: ctypes.CDLL, libc: ctypes.CDLL) -> None:
    """Forbid this process what the unit forbids; the last thing before its command runs."""
    seccomp.seccomp_init.restype = ctypes.c_void_p
    seccomp.seccomp_rule_add_array.argtypes = (
        ctypes.c_void_p,
        ctypes.c_uint32,
        ctypes.c_int,
        ctypes.c_uint,
        ctypes.POINTER(_Argument),
    )
    seccomp.seccomp_load.argtypes = (ctypes.c_void_p,)
    rules = seccomp.seccomp_init(ctypes.c_uint32(KILL_PROCESS))
    families = [int(getattr(socket, name)) for name in settings["RestrictAddressFamilies"][0].split()]
    for name in sorted(calls):
        number = seccomp.seccomp_syscall_resolve_name(name.encode())
        if number < 0:  # of another processor
            continue
        conditions = [[_Argument(0, EQUAL, family, 0)] for family in families] if name == "socket" else [[]]
        for condition in conditions:
            given = (_Argument * len(condition))(*condition)
            if seccomp.seccomp_rule_add_array(rules, ALLOW, number, len(condition), given) != 0:
                raise SystemExit(f"no rule for {name}")
    for name in REFUSED_IN_VAIN:
        seccomp.seccomp_rule_add_array(
            rules, NOT_PERMITTED, seccomp.seccomp_syscall_resolve_name(name.encode()), 0, None
        )
    if settings["MemoryDenyWriteExecute"] == ["yes"] and libc.prctl(MEMORY_DENY_WRITE_EXECUTE, 1, 0, 0, 0) != 0:
        raise SystemExit("this kernel knows no PR_SET_MDWE; it needs 6.3 or newer")
    if libc.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0) != 0 or seccomp.seccomp_load(rules) != 0:
        raise SystemExit("the filter of system calls cannot be loaded")


def main(unit: Path, root: Path) -> None:
    """Become the unit's process."""
    settings = settings_of(unit)
    calls = allowed_calls(settings)
    seccomp, libc = ctypes.CDLL("libseccomp.so.2"), ctypes.CDLL(None, use_errno=True)
    user, group = account_of(root, settings["User"][0])
    arrange(root, settings)
    environment = {
        "PATH": "/usr/local/bin:/usr/bin:/bin",
        "USER": settings["User"][0],
        **dict(word.split("=", 1) for line in settings["Environment"] for word in shlex.split(line)),
        **{name: os.environ[name] for name in ("NOTIFY_SOCKET", "WATCHDOG_USEC") if name in os.environ},
    }
    os.chroot(root)
    os.chdir(settings["WorkingDirectory"][0])
    os.umask(int(settings["UMask"][0], 8))
    for limit, value in (("NOFILE", "LimitNOFILE"), ("CORE", "LimitCORE")):
        count = int(settings[value][0])
        resource.setrlimit(getattr(resource, f"RLIMIT_{limit}"), (count, count))
    if settings["CapabilityBoundingSet"] == [""]:
        for capability in range(CAPABILITIES_COUNT):
            libc.prctl(DROP_BOUNDING, capability, 0, 0, 0)
    os.setgroups([group])
    os.setresgid(group, group, group)
    os.setresuid(user, user, user)
    confine(settings, calls, seccomp, libc)
    command = shlex.split(settings["ExecStart"][0])
    os.execve(command[0], command, environment)  # noqa: S606 - the unit's own command line


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
