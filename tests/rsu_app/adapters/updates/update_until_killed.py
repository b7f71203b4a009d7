"""A program for the kill test: takes up three releases, and is killed at every step of it, one after the other.

Every attempt is a fork that ends itself with SIGKILL just before or just after its n-th call that changes a file or
makes one last; n grows until an attempt gets through. After each, the parent looks at what is left, and goes on from
there to the end. For a power cut the fork first takes back whatever it had not made last: the content of files
without fsync, and new names in folders without one.
"""

from __future__ import annotations

import builtins
import contextlib
import gc
import io
import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

from roadgrip.bundle_json import manifest_from_json
from roadgrip.errors import BundleError
from rsu_app.adapters.updates import FolderShelf, TufReleaseSource, shelf
from rsu_app.domain.rollout import RolloutState, Stage, confirmed, installed, rolled_back, switched
from rsu_app.rollout_ports import FetchedRelease

# A pure function of a text, asked thousands of times about two texts; what lies on the disk is still read each time.
shelf.manifest_from_json = cache(manifest_from_json)  # type: ignore[attr-defined]  # it is of another module

LAST_RELEASE = 3
Tell = Callable[[RolloutState], None]


@dataclass(frozen=True)
class Site:
    """Where everything lies. The repositories are those after each of the releases."""

    repositories: Path
    folder: Path

    @property
    def shelf(self) -> FolderShelf:
        return FolderShelf(self.folder / "shelf")

    def source(self, release_number: int) -> TufReleaseSource:
        return TufReleaseSource(
            str(self.repositories / str(release_number)),
            trusted_root=self.repositories / "trusted-root.json",
            cache_folder=self.folder / "cache",
            unix_s=time.time,
        )


# What a unit does ----------------------------------------------------------------------------------------------------


def take_up_everything(site: Site, tell: Tell) -> RolloutState:
    """Return the last state after taking up what is left of the releases; the last one is rolled back."""
    here = site.shelf
    state = here.state()
    while state.newest_sequence_number < LAST_RELEASE or state.stage is not Stage.SETTLED:
        state = next_state(site, here, state)
        here.keep_state(state)
        tell(state)
        here.clear(state)
    here.clear(state)
    return state


def next_state(site: Site, here: FolderShelf, state: RolloutState) -> RolloutState:
    newest = state.newest_sequence_number
    match state.stage:
        case Stage.SHADOW:
            return switched(state)
        case Stage.PROBATION:
            return rolled_back(state) if newest == LAST_RELEASE else confirmed(state)
        case _:
            fetched = site.source(newest + 1).fetch("canary", newer_than=newest, into=here.incoming_folder)
            assert isinstance(fetched, FetchedRelease), fetched
            assert fetched.folder is not None
            return installed(state, here.put(fetched.release, fetched.folder))


# What happens to it --------------------------------------------------------------------------------------------------


@dataclass
class Disk:
    """Counts what is done to files, remembers what would not outlast a power cut, and ends the process in time.

    Attributes:
        folder: Below it, a power cut takes back what did not last.
        backups_folder: Keeps what a rename wrote over; on the same file system.
        moments_count: The process ends at this moment; every call has one before it and one after it.
        power_cut: Whether what did not last is taken back first.
    """

    folder: Path
    backups_folder: Path
    moments_count: int
    power_cut: bool
    backups_count: int = 0
    real: dict[str, Callable[..., Any]] = field(default_factory=dict)
    unsynced_inodes: set[int] = field(default_factory=set)
    unsynced_names: list[tuple[Path, Callable[[], None]]] = field(default_factory=list)

    def watch(self) -> None:
        for name in ("replace", "rename", "fsync", "open", "unlink", "remove", "mkdir", "rmdir", "symlink"):
            self.real[name] = getattr(os, name)
        self.real["io_open"] = io.open
        for name in ("unlink", "remove", "rmdir", "symlink"):
            setattr(os, name, self.counted(self.real[name]))
        os.replace = self.counted(self.moved)
        os.rename = self.counted(self.moved)
        os.mkdir = self.counted(self.made)
        os.fsync = self.counted(self.synced)
        os.open = self.opened
        io.open = builtins.open = self.opened_as_file  # type: ignore[assignment]  # theirs has an overload per mode

    def moment(self) -> None:
        self.moments_count -= 1
        if self.moments_count == 0:
            if self.power_cut:
                # Nothing of this is counted: the moment has come.
                self.take_back()
            os.kill(os.getpid(), signal.SIGKILL)

    def counted(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def called(*arguments: Any, **options: Any) -> Any:
            self.moment()
            result = call(*arguments, **options)
            self.moment()
            return result

        return called

    def opened(self, path: Any, flags: int, *arguments: Any, **options: Any) -> int:
        if not flags & (os.O_WRONLY | os.O_RDWR):
            return int(self.real["open"](path, flags, *arguments, **options))
        self.moment()
        descriptor = int(self.real["open"](path, flags, *arguments, **options))
        self.unsynced_inodes.add(os.fstat(descriptor).st_ino)
        self.moment()
        return descriptor

    def opened_as_file(self, path: Any, mode: str = "r", *arguments: Any, **options: Any) -> Any:
        if not set(mode) & set("wax+"):
            return self.real["io_open"](path, mode, *arguments, **options)
        self.moment()
        file = self.real["io_open"](path, mode, *arguments, **options)
        self.unsynced_inodes.add(os.fstat(file.fileno()).st_ino)
        self.moment()
        return file

    def synced(self, descriptor: int) -> None:
        self.real["fsync"](descriptor)
        inode = os.fstat(descriptor).st_ino
        self.unsynced_inodes.discard(inode)
        self.unsynced_names = [
            (parent, undo) for parent, undo in self.unsynced_names if parent.exists() and parent.stat().st_ino != inode
        ]

    def moved(self, old: Any, new: Any, **options: Any) -> None:
        old, new = Path(old), Path(new)
        self.backups_count += 1
        backup = self.backups_folder / str(self.backups_count)
        with contextlib.suppress(OSError):
            os.link(new, backup)
        self.real["rename"](old, new, **options)

        def undo() -> None:
            self.real["rename"](new, old)
            if backup.exists():
                self.real["rename"](backup, new)

        self.unsynced_names.append((new.parent, undo))

    def made(self, path: Any, *arguments: Any, **options: Any) -> None:
        self.real["mkdir"](path, *arguments, **options)
        self.unsynced_names.append((Path(path).parent, lambda: shutil.rmtree(path)))

    def take_back(self) -> None:
        for parent, names, files in os.walk(self.folder):
            for path in (Path(parent, name) for name in (*names, *files)):
                if path.is_file() and path.stat().st_ino in self.unsynced_inodes:
                    os.truncate(path, path.stat().st_size // 2)
        for _, undo in reversed(self.unsynced_names):
            with contextlib.suppress(OSError):
                undo()


# Who looks at what is left -------------------------------------------------------------------------------------------


def attempt(site: Site, moments_count: int, *, power_cut: bool) -> tuple[bool, int]:
    """Return whether a fork got through before the moment came, and how many states it had been told are kept."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        run_attempt(site, moments_count, power_cut=power_cut, writing=writing)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        kept_count = len(pipe.read())
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        assert os.WTERMSIG(status) == signal.SIGKILL
        return False, kept_count
    assert os.WEXITSTATUS(status) == 0, f"the attempt failed by itself, with its end set to moment {moments_count}"
    return True, kept_count


def run_attempt(site: Site, moments_count: int, *, power_cut: bool, writing: int) -> NoReturn:
    try:
        disk = Disk(site.folder, site.folder.parent / "backups", moments_count, power_cut)
        disk.watch()
        take_up_everything(site, lambda _: tell_parent(writing))
        os._exit(0)
    except BaseException:  # noqa: BLE001 - a fork must never return
        traceback.print_exc()
        os._exit(1)


def tell_parent(writing: int) -> None:
    os.write(writing, b".")


def check_what_runs(site: Site, story: list[RolloutState], kept_count: int) -> None:
    """Fail unless a unit that starts now goes on from the last state it was told is kept, or from the next one."""
    here = site.shelf
    state = here.state()
    assert not here.notes, here.notes
    assert state in story[kept_count : kept_count + 2], (state, kept_count)
    for bundle in (state.live, state.previous, state.candidate):
        if bundle is not None and not bundle.from_factory:
            here.folder_of(bundle)


def check_end(site: Site, state: RolloutState, story: list[RolloutState]) -> None:
    assert state == story[-1]
    here = site.shelf
    assert here.state() == state
    place = here.folder_of(state.live)
    left = {str(path.relative_to(site.folder / "shelf")) for path in (site.folder / "shelf").glob("*")}
    assert left == {"bundles", "state.json"}, left
    assert list(place.parent.iterdir()) == [place]


def the_whole_story(site: Site) -> list[RolloutState]:
    story = [site.shelf.state()]
    take_up_everything(site, story.append)
    return story


def start_afresh(site: Site) -> None:
    for folder in (site.folder, site.folder.parent / "backups"):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
    # Files without names, and folders of a moment, go where each attempt is cleared away.
    tempfile.tempdir = str(site.folder.parent / "backups")


def main(repositories: str, folder: str, end: str) -> None:
    """Print how often the unit was ended: by "kill", by "power cut", or "in turn" before and after a call."""
    site = Site(Path(repositories), Path(folder, "unit"))
    start_afresh(site)
    story = the_whole_story(site)
    # By now python-tuf is imported, so that no fork pays for it. A collection in one would copy whatever it looks at.
    gc.freeze()
    moments_count = 0
    through = False
    while not through:
        moments_count += 1
        start_afresh(site)
        through, kept_count = attempt(
            site, moments_count, power_cut=end == "power cut" or (end == "in turn" and moments_count % 2 == 0)
        )
        try:
            check_what_runs(site, story, kept_count)
            check_end(site, take_up_everything(site, lambda _: None), story)
        except (AssertionError, BundleError) as error:
            error.add_note(f"after the end at moment {moments_count}")
            raise
    sys.stdout.write(f"ended {moments_count - 1} times, {len(story)} states\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
