"""The last maps on disk, so that a client that starts anew knows them and announces which it has.

One file per section, named by a digest of the section's name. A map tells its own version, which is a digest of what
it holds, so a file that was damaged is noticed, dropped and counted.
"""

from __future__ import annotations

import contextlib
import os
from hashlib import sha256
from typing import TYPE_CHECKING

from roadgrip.errors import ConfigurationError, SectionError
from roadgrip.section_file import TEXT_LIMIT_CHARS, section_from_json, section_to_json
from vehicle_client.shell.whole_file import PART_SUFFIX, write_whole

if TYPE_CHECKING:
    from pathlib import Path

    from roadgrip.section import RoadSection

_SUFFIX = ".json"


class MapStore:
    """A folder of maps; only one process may use it."""

    def __init__(self, folder: Path, *, capacity_count: int) -> None:
        """Open a folder, or make it.

        Args:
            folder: Holds one file per map and nothing else.
            capacity_count: Maps kept; the one used longest ago goes when one more comes.

        Raises:
            ConfigurationError: The folder cannot be made or read.
        """
        self._folder = folder
        self._capacity_count = capacity_count
        self.unreadable_count = 0
        """Files dropped because they hold no map, or another than they say."""
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for leftover in folder.glob(f"*{PART_SUFFIX}"):
                leftover.unlink()
        except OSError as error:
            raise ConfigurationError(f"cannot keep maps in {folder}: {error.strerror}") from error

    def load(self) -> tuple[RoadSection, ...]:
        """Return the maps, the one used last at the end."""
        maps = []
        for path in self._paths():
            section = _read(path)
            if section is None or path != self._path(section.section_id):
                self.unreadable_count += 1
                with contextlib.suppress(OSError):
                    path.unlink()
            else:
                maps.append(section)
        return tuple(maps[-self._capacity_count :])

    def keep(self, section: RoadSection) -> None:
        """Write a map, in place of an earlier one of the section.

        Raises:
            OSError: The disk takes nothing; an earlier map is as it was.
        """
        write_whole(self._path(section.section_id), section_to_json(section))
        for oldest in self._paths()[: -self._capacity_count]:
            oldest.unlink(missing_ok=True)

    def touch(self, section_id: str) -> None:
        """Take that a map was used; nothing happens if it is not kept."""
        with contextlib.suppress(OSError):
            os.utime(self._path(section_id))

    def _path(self, section_id: str) -> Path:
        return self._folder / f"{sha256(section_id.encode()).hexdigest()[:32]}{_SUFFIX}"

    def _paths(self) -> list[Path]:
        """Return the files, the one used longest ago first."""
        return sorted(self._folder.glob(f"*{_SUFFIX}"), key=lambda path: path.stat().st_mtime_ns)


def _read(path: Path) -> RoadSection | None:
    try:
        if path.stat().st_size > TEXT_LIMIT_CHARS:
            return None
        text = path.read_text(encoding="utf-8")
        # A map without a version could not be checked; ours have one.
        return section_from_json(text) if '"version"' in text else None
    except (OSError, ValueError, SectionError):
        return None
