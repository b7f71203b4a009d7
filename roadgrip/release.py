"""Releases: which bundle the units of a ring shall run, and where a signed repository keeps it.

A repository is a TUF repository in a plain folder: `metadata/` and `targets/`. Its targets are bundles, file by file,
and one small pointer per ring. What is signed is the list of targets with their digests, so a pointer cannot be joined
to another bundle than the one it was signed with.

References:
    The Update Framework, specification 1.0: https://theupdateframework.github.io/specification/latest/
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from roadgrip.errors import RoadgripError

METADATA_FOLDER = "metadata"
TARGETS_FOLDER = "targets"
DEFAULT_RINGS = ("canary", "all")
"""Who gets a bundle first, and who after that."""
RELEASE_FORMAT_VERSION = 1
_RING = re.compile(r"[a-z][a-z0-9-]{0,31}")
_BUNDLE_ID = re.compile(r"[0-9a-f]{16}")
_FILE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_SHA256 = re.compile(r"[0-9a-f]{64}")


class ReleaseError(RoadgripError):
    """A release that cannot be; the message says why."""


@dataclass(frozen=True, slots=True)
class Release:
    """What the units of a ring shall run from now on.

    Attributes:
        ring: Name of a group of units.
        sequence_number: Grows with every release of a laboratory, over all rings; a unit never goes back.
        bundle_id: What to run. A deliberate step back is a new release of an old bundle.
        files_sha256: SHA-256 of every file of the bundle, its manifest among them.
        released_unix_s: When it was decided, by the laboratory's clock.
        released_by: Who decided.
        reason: Why.
        gate: "passed", "overridden", or "none" for the first bundle of all, which nothing was held against.
        ledger_hash: Of the laboratory's ledger entry about this release.
    """

    ring: str
    sequence_number: int
    bundle_id: str
    files_sha256: Mapping[str, str]
    released_unix_s: int
    released_by: str
    reason: str
    gate: str
    ledger_hash: str

    def __post_init__(self) -> None:
        problems = {
            f"the ring is called {self.ring!r}": not _RING.fullmatch(self.ring),
            f"the sequence number is {self.sequence_number}": self.sequence_number < 1,
            f"the bundle is called {self.bundle_id!r}": not _BUNDLE_ID.fullmatch(self.bundle_id),
            "a file has a name that no file of a bundle has": not self.files_sha256
            or not all(_FILE.fullmatch(name) for name in self.files_sha256),
            "a digest is none": not all(_SHA256.fullmatch(digest) for digest in self.files_sha256.values()),
            f"the gate said {self.gate!r}": self.gate not in {"passed", "overridden", "none"},
        }
        for problem, found in problems.items():
            if found:
                raise ReleaseError(f"not a release: {problem}")


def ring_target(ring: str) -> str:
    """Return the target path of a ring's pointer.

    Raises:
        ReleaseError: A ring is a lower-case letter, then letters, digits and hyphens.
    """
    if not _RING.fullmatch(ring):
        raise ReleaseError(f"{ring!r} is no name of a ring: a lower-case letter, then letters, digits and hyphens")
    return f"rings/{ring}.json"


def bundle_target(bundle_id: str, file_name: str) -> str:
    """Return the target path of a bundle's file."""
    return f"bundles/{bundle_id}/{file_name}"


def release_to_json(release: Release) -> str:
    """Return a release as JSON text that `release_from_json` reads back to an equal record."""
    return json.dumps({"format_version": RELEASE_FORMAT_VERSION, **asdict(release)}, indent=1, sort_keys=True) + "\n"


def release_from_json(text: str) -> Release:
    """Return the release that a JSON text holds.

    Raises:
        ReleaseError: The text holds none.
    """
    try:
        raw: dict[str, Any] = json.loads(text)
        if raw["format_version"] != RELEASE_FORMAT_VERSION:
            raise ReleaseError(f"release format {raw['format_version']}, this software reads {RELEASE_FORMAT_VERSION}")
        return Release(
            ring=str(raw["ring"]),
            sequence_number=int(raw["sequence_number"]),
            bundle_id=str(raw["bundle_id"]),
            files_sha256={str(name): str(digest) for name, digest in raw["files_sha256"].items()},
            released_unix_s=int(raw["released_unix_s"]),
            released_by=str(raw["released_by"]),
            reason=str(raw["reason"]),
            gate=str(raw["gate"]),
            ledger_hash=str(raw["ledger_hash"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise ReleaseError(f"not a release: {type(error).__name__} at {error}") from error
