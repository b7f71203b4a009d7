"""What the project leans on, looked through: locks, what is installed, licences, known vulnerabilities.

python -m deploy.audit --pip-audit build/audit-venv/bin/pip-audit     (`make audit`)

Whether a version has a known vulnerability only a database in the network knows. If it cannot be asked, or does not
know the packages, that is said, and the command does not succeed: 0 asked and nothing found, 1 something found, 3
nothing found here but the database was not asked (or only about some).
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ASKED, FOUND, NOT_ASKED = 0, 1, 3
ROLES = ("rsu", "vehicle", "vehicle-files", "training", "dev")
ON_THE_POLE = ("rsu", "vehicle")
"""Roles that are handed to others, so that their licences bind."""
_PIN = re.compile(r"^(?P<name>[A-Za-z0-9._-]+)(?:\[[^\]]*\])?==(?P<version>[^\s;\\]+)")
_HASH = re.compile(r"--hash=sha256:[0-9a-f]{64}\b")
_ADDRESS = re.compile(r"://|^--(?:index|extra-index|find-links|trusted-host)|^-[if] |@\s*(?:git|file|https?)\b")
_COPYLEFT = re.compile(r"(?<!L)(?<!LESSER )(?:\bA?GPL|GENERAL PUBLIC LICENSE|AFFERO)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Pin:
    """One line of a lock.

    Attributes:
        name: Of the package, as registries spell it.
        version: The only one that is installed.
        hashes_count: Files that may be installed.
    """

    name: str
    version: str
    hashes_count: int


def pins_of(lock: str) -> Iterator[Pin]:
    """Yield what a lock pins; a requirement that is no pin comes with an empty version.

    Args:
        lock: Text of a requirements file.
    """
    for entry in re.split(r"\n(?=[^\s#])", re.sub(r"^\s*#.*\n?", "", lock, flags=re.MULTILINE)):
        line = entry.strip()
        if not line or line.startswith("-"):
            continue
        found = _PIN.match(line)
        name = found["name"] if found else re.split(r"[\s\[<>=!~;@]", line)[0]
        yield Pin(re.sub(r"[-_.]+", "-", name).lower(), found["version"] if found else "", len(_HASH.findall(entry)))


def lock_problems(name: str, lock: str) -> list[str]:
    """Return what is wrong with a lock: an address, a version left open, a file that nobody vouches for."""
    problems = [
        f"{name}:{number}: an address in a lock: {line.strip()[:60]}"
        for number, line in enumerate(lock.splitlines(), start=1)
        if _ADDRESS.search(line) and not line.lstrip().startswith("#")
    ]
    pins = list(pins_of(lock))
    problems += [f"{name}: {pin.name} is not pinned to a version" for pin in pins if not pin.version]
    problems += [f"{name}: {pin.name} has no SHA-256" for pin in pins if not pin.hashes_count]
    return problems + ([] if pins else [f"{name}: nothing is locked"])


def disagreements(locks: Mapping[str, str]) -> list[str]:
    """Return packages that are locked to another version for one role than for another."""
    versions: dict[str, dict[str, set[str]]] = {}
    for role, lock in locks.items():
        for pin in pins_of(lock):
            versions.setdefault(pin.name, {}).setdefault(role, set()).add(pin.version)
    return [
        f"{name} is locked to {', '.join(sorted(set().union(*by_role.values())))}, not the same for every role"
        for name, by_role in sorted(versions.items())
        if len({frozenset(found) for found in by_role.values()}) > 1
    ]


def licence_of(package: Distribution) -> str:
    """Return what an installed package says of its licence, in the most exact of its words; nothing if it is silent."""
    said = package.metadata.get_all
    classifiers = [each.rpartition("::")[2].strip() for each in said("Classifier") or () if "License ::" in each]
    words = (said("License-Expression") or [""])[0] or ", ".join(classifiers) or (said("License") or [""])[0]
    return words.strip().partition("\n")[0]


def installed_problems(lock: str) -> list[str]:
    """Return where what is installed is not what is locked; what is not installed is no problem.

    A package may be locked to one version for an old Python and to another for a new one.
    """
    locked: dict[str, set[str]] = {}
    for pin in pins_of(lock):
        locked.setdefault(pin.name, set()).add(pin.version)
    return [
        f"{name} {package.version} is installed, {' or '.join(sorted(versions))} is locked"
        for name, versions in locked.items()
        if (package := _installed(name)) is not None and package.version not in versions
    ]


def licence_problems(lock: str) -> list[str]:
    """Return licences that would bind whoever hands the software on, and packages that name none."""
    problems = []
    for pin in pins_of(lock):
        package = _installed(pin.name)
        if package is None:
            continue
        licence = licence_of(package)
        if not licence:
            problems.append(f"{pin.name} names no licence")
        elif _COPYLEFT.search(licence) and " OR " not in licence:
            problems.append(f"{pin.name} is under {licence[:60]}")
    return problems


def _installed(name: str) -> Distribution | None:
    try:
        return distribution(name)
    except PackageNotFoundError:
        return None


@dataclass(frozen=True, slots=True)
class Answer:
    """What the database of vulnerabilities said.

    Attributes:
        asked_count: Packages it knows.
        unknown_count: Packages it was asked about and does not know.
        vulnerable: What is vulnerable, in words.
        problem: Why it could not be asked at all; empty if it could.
    """

    asked_count: int
    unknown_count: int
    vulnerable: tuple[str, ...] = ()
    problem: str = ""


def answer_in(text: str) -> Answer:
    """Return what pip-audit's JSON says. A package it skipped was not looked up, whatever its exit code."""
    try:
        packages = json.loads(text)["dependencies"]
        skipped = [each for each in packages if "skip_reason" in each]
        vulnerable = tuple(
            f"{each['name']} {each['version']}: {', '.join(found['id'] for found in each['vulns'])}"
            for each in packages
            if each.get("vulns")
        )
    except (ValueError, KeyError, TypeError) as error:
        return Answer(0, 0, problem=f"pip-audit answers nonsense: {type(error).__name__}")
    return Answer(len(packages) - len(skipped), len(skipped), vulnerable)


def looked_up(tool: Path | None, lock: Path) -> Answer:
    """Return what is known of the packages of a lock."""
    if tool is None or not tool.exists():
        return Answer(0, 0, problem="pip-audit is not here and could not be fetched")
    command = [
        str(tool),
        "--require-hashes",
        "--disable-pip",
        "--progress-spinner",
        "off",
        "-f",
        "json",
        "-r",
        str(lock),
    ]
    try:
        ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    except subprocess.TimeoutExpired:
        return Answer(0, 0, problem="the database does not answer")
    if not ended.stdout.strip():
        lines = ended.stderr.strip().splitlines() or ["no words"]
        return Answer(0, 0, problem=f"the database cannot be asked ({lines[-1].split('://')[0][:60].strip()})")
    return answer_in(ended.stdout)


def main(arguments: Sequence[str] | None = None) -> int:
    """Look through everything, say what was found and what was not looked at."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pip-audit", type=Path, help="the tool that asks the database of vulnerabilities")
    options = parser.parse_args(arguments)
    locks = {role: (ROOT / "requirements" / f"{role}.txt").read_text(encoding="utf-8") for role in ROLES}
    everything = dict(locks)
    everything["bootstrap"] = (ROOT / "requirements" / "bootstrap.txt").read_text(encoding="utf-8")
    problems = [each for role, lock in everything.items() for each in lock_problems(f"requirements/{role}.txt", lock)]
    problems += disagreements(locks)
    problems += installed_problems(locks["dev"])
    problems += sorted({each for role in ON_THE_POLE for each in licence_problems(locks[role])})
    count = len({pin.name for pin in pins_of(locks["dev"])})
    print(
        f"locks      {len(everything)} files, {count} packages: pinned, hashed, without addresses"
        if not problems
        else ""
    )
    for problem in problems:
        print(f"FOUND      {problem}")
    answer = looked_up(options.pip_audit, ROOT / "requirements" / "dev.txt")
    for each in answer.vulnerable:
        print(f"VULNERABLE {each}")
    print("not looked at: how old a version is, and whether its maker took it back")
    if problems or answer.vulnerable:
        return FOUND
    if answer.problem or answer.unknown_count:
        why = (
            answer.problem or f"it does not know {answer.unknown_count} of {answer.unknown_count + answer.asked_count}"
        )
        print(f"NOT AUDITED for known vulnerabilities: {why}.", file=sys.stderr)
        print(
            "Everything above was looked at on this machine alone. Run this where the database can be reached.",
            file=sys.stderr,
        )
        return NOT_ASKED
    print(f"database   asked about {answer.asked_count} packages, none is known to be vulnerable")
    return ASKED


if __name__ == "__main__":
    sys.exit(main())
