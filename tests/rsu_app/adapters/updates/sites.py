"""A unit's side of a repository: a source, a shelf, and a bundle that runs from it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rsu_app.adapters.updates import FolderShelf, TufReleaseSource
from rsu_app.domain.rollout import RolloutState, confirmed, installed, switched
from rsu_app.rollout_ports import FetchedRelease, UpdateReason, UpdateRefusal
from tests.repositories import SignedRepository, make_small_bundle


def content_of(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


class UpdateSite:
    """A unit that trusts a repository.

    Args:
        folder: For everything.
        repository: What it trusts; one with defaults by default.
    """

    def __init__(self, folder: Path, repository: SignedRepository | None = None) -> None:
        self.folder = folder
        self.repository = repository or SignedRepository(folder / "repository")
        self.trusted_root = folder / "trusted-root.json"
        self.trusted_root.write_bytes(self.repository.trusted_root)
        self.cache_folder = folder / "cache"
        self.shelf = FolderShelf(folder / "shelf")

    def bundle(self, bias_mu: float = 0.5) -> Path:
        """Return a folder with a bundle of its own for every bias."""
        folder = self.folder / f"bundle-{bias_mu}"
        make_small_bundle(folder, bias_mu=bias_mu)
        return folder

    def source(self, address: str = "", *, unix_s: Callable[[], float] = time.time, **options: Any) -> TufReleaseSource:
        return TufReleaseSource(
            address or str(self.repository.folder),
            trusted_root=self.trusted_root,
            cache_folder=self.cache_folder,
            unix_s=unix_s,
            **options,
        )

    def fetch(
        self, source: TufReleaseSource | None = None, *, ring: str = "canary", newer_than: int = 0
    ) -> FetchedRelease | UpdateRefusal | None:
        return (source or self.source()).fetch(ring, newer_than=newer_than, into=self.shelf.incoming_folder)

    def fetched(self, source: TufReleaseSource | None = None, *, newer_than: int = 0) -> FetchedRelease:
        """Return what was fetched, or say why not."""
        outcome = self.fetch(source, newer_than=newer_than)
        assert isinstance(outcome, FetchedRelease), outcome
        return outcome

    def refusal(self, source: TufReleaseSource | None = None, **options: Any) -> UpdateRefusal:
        """Return why nothing was fetched, after a look whether everything else stayed as it was."""
        before = content_of(self.shelf.incoming_folder.parent)
        outcome = self.fetch(source, **options)
        assert isinstance(outcome, UpdateRefusal), outcome
        assert content_of(self.shelf.incoming_folder.parent) == before
        return outcome

    def reason(self, source: TufReleaseSource | None = None, **options: Any) -> UpdateReason:
        return self.refusal(source, **options).reason

    def run_first_release(self) -> RolloutState:
        """Publish a bundle, fetch it and run it."""
        self.repository.release(self.bundle(), sequence_number=1)
        fetched = self.fetched()
        assert fetched.folder is not None
        state = confirmed(switched(installed(RolloutState(), self.shelf.put(fetched.release, fetched.folder))))
        self.shelf.keep_state(state)
        return state

    def runs_on(self) -> bool:
        """Return whether the bundle of release 1 still runs, whole, and nothing else has been taken up."""
        state = self.shelf.state()
        assert self.shelf.notes == ()
        return self.shelf.folder_of(state.live).is_dir() and state.newest_sequence_number == 1
