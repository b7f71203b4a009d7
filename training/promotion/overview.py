"""A repository for people: rings, bundles, versions, dates, keys."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from roadgrip.release import Release
from training.promotion.change import staged_change
from training.promotion.keys import ROLES
from training.promotion.repository import Repository, bundle_ids, periods_of

SOON_SHARE = 0.2
"""A document in the last fifth of its time is about to expire."""
_DAY_S = 86_400.0


@dataclass(frozen=True, slots=True)
class RoleView:
    """A role of the repository.

    Attributes:
        role: Its name.
        version: Of its metadata.
        expires_unix_s: When that ends.
        period_days: How long it lasted when it was signed.
        key_ids: Who may sign.
        threshold_count: How many must.
    """

    role: str
    version: int
    expires_unix_s: int
    period_days: int
    key_ids: tuple[str, ...]
    threshold_count: int

    def state(self, *, now_unix_s: float) -> str:
        """Return "good", "expires soon" or "expired"."""
        left_s = self.expires_unix_s - now_unix_s
        if left_s <= 0.0:
            return "expired"
        return "expires soon" if left_s < SOON_SHARE * self.period_days * _DAY_S else "good"


@dataclass(frozen=True, slots=True)
class Overview:
    """A repository.

    Attributes:
        roles: In the order root, targets, snapshot, timestamp.
        releases: What each ring runs.
        bundle_ids: All bundles it holds.
        waiting: The change that waits for signatures; None without one.
    """

    roles: tuple[RoleView, ...]
    releases: dict[str, Release]
    bundle_ids: tuple[str, ...]
    waiting: str | None


def overview(repository: Repository) -> Overview:
    """Return what a repository holds.

    Raises:
        RepositoryFolderError: There is none, or it must not be trusted.
    """
    published = repository.published()
    root = published.root.signed
    signed = {
        "root": root,
        "targets": published.targets.signed,
        "snapshot": published.snapshot.signed,
        "timestamp": published.timestamp.signed,
    }
    periods, change = periods_of(root), staged_change(repository)
    return Overview(
        roles=tuple(
            RoleView(
                role=role,
                version=signed[role].version,
                expires_unix_s=int(signed[role].expires.timestamp()),
                period_days=periods[role],
                key_ids=tuple(root.roles[role].keyids),
                threshold_count=root.roles[role].threshold,
            )
            for role in ROLES
        ),
        releases=repository.releases(published.targets.signed),
        bundle_ids=tuple(bundle_ids(published.targets.signed)),
        waiting=None if change is None else change.what,
    )


def day(unix_s: int) -> str:
    """Return a date in UTC, as people write it."""
    return f"{datetime.fromtimestamp(unix_s, tz=UTC):%Y-%m-%d}"
