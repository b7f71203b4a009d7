"""A signed repository, as a unit sees it: what its ring shall run, or why that must not be taken.

What python-tuf is needed for stands in `rsu_app.adapters.updates.visit` and is imported by the first visit.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rsu_app.adapters.updates.limits import FetchLimits
from rsu_app.rollout_ports import FetchedRelease, UpdateReason, UpdateRefusal
from rsu_app.usecases.readiness import EARLIEST_SANE_UNIX_S

CLOCK_TOLERANCE_S = 86_400.0
"""A wall clock may be so far behind the newest moment the unit has proof of; a clock that is set right steps back."""
ROOT_LIMIT_BYTES = 512_000
"""A larger trusted root is none; python-tuf refuses such roots of a repository, too."""


class TufReleaseSource:
    """A repository of The Update Framework; see `rsu_app.rollout_ports.ReleaseSource` for what it promises.

    One visit at a time: the cache is for one.

    Args:
        address: A folder, as a path or a file:// address, or an http(s):// address.
        trusted_root: The root metadata that a technician brought; all trust begins there.
        cache_folder: Remembers the newest metadata seen, against downgrades; made if missing. It may be lost: the
            releases the unit has taken are numbered, too.
        unix_s: The wall clock.
        not_before_unix_s: The newest moment the unit has proof of, such as its last entry in the ledger.
        limits: What a visit may take.
    """

    def __init__(
        self,
        address: str,
        *,
        trusted_root: Path,
        cache_folder: Path,
        unix_s: Callable[[], float],
        not_before_unix_s: float = 0.0,
        limits: FetchLimits | None = None,
    ) -> None:
        self._address = address
        self._trusted_root = trusted_root
        self._cache_folder = cache_folder
        self._unix_s = unix_s
        self._not_before_unix_s = not_before_unix_s
        self._limits = limits or FetchLimits()

    def fetch(self, ring: str, *, newer_than: int, into: Path) -> FetchedRelease | UpdateRefusal | None:
        """Return the release of a ring with its files, None if it is no news, or why it must not be taken.

        Args:
            ring: The unit's own.
            newer_than: Sequence number of the newest release the unit knows; the files of others are not fetched. A
                ring whose release is older than that is a downgrade.
            into: Folder for the files; emptied first, made if missing.
        """
        trusted_root = self._trusted_root_bytes()
        refusal = trusted_root if isinstance(trusted_root, UpdateRefusal) else self._clock_refusal()
        if refusal is not None or isinstance(trusted_root, UpdateRefusal):
            return refusal
        # A tenth of a second of CPU and 12 MB, which a unit that is starting has better uses for.
        from rsu_app.adapters.updates.visit import Visit

        visit = Visit(self._address, trusted_root=trusted_root, cache_folder=self._cache_folder, limits=self._limits)
        return visit.fetch(ring, newer_than=newer_than, into=into)

    def _trusted_root_bytes(self) -> bytes | UpdateRefusal:
        try:
            with self._trusted_root.open("rb") as file:
                return file.read(ROOT_LIMIT_BYTES)
        except OSError as error:
            return UpdateRefusal(
                UpdateReason.NOT_CONFIGURED,
                f"the trusted root {self._trusted_root} cannot be read ({error.strerror or error}): put the"
                " laboratory's trusted-root.json there",
            )

    def _clock_refusal(self) -> UpdateRefusal | None:
        now_unix_s = self._unix_s()
        earliest_unix_s = max(EARLIEST_SANE_UNIX_S, self._not_before_unix_s - CLOCK_TOLERANCE_S)
        # Written so that NaN, which compares false with everything, is refused too.
        if now_unix_s >= earliest_unix_s:
            return None
        return UpdateRefusal(
            UpdateReason.CLOCK,
            f"the wall clock says {now_unix_s:.0f} s since 1970 and cannot be right before {earliest_unix_s:.0f} s:"
            " whether metadata has expired cannot be told until it is set",
        )
