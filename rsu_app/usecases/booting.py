"""What a unit starts with: the live bundle of its shelf, or else what is left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from roadgrip.errors import BundleError, FeatureTableError
from rsu_app.domain.rollout import RolloutState, rolled_back
from rsu_app.ports import FrictionModel
from rsu_app.rollout_ports import BundleShelf


@dataclass(frozen=True, slots=True)
class Loading:
    """How bundles become models. Both block; they run on another thread.

    Attributes:
        from_folder: Loads and proves the bundle of a folder.
        factory: Loads the bundle that came with the software or that the settings name.
    """

    from_folder: Callable[[Path], FrictionModel]
    factory: Callable[[], FrictionModel]


@dataclass(frozen=True, slots=True)
class Boot:
    """What a unit starts with.

    Attributes:
        model: The live model; None if not even the factory's can be used.
        state: What the shelf is for from now on.
        notes: What a person should know about it, such as a bundle that was found damaged.
        left_behind: Whether a bundle of the shelf, or the shelf's own file, could not be used: then the shelf is told.
    """

    model: FrictionModel | None
    state: RolloutState
    notes: tuple[str, ...]
    left_behind: bool = False


def boot(shelf: BundleShelf, loading: Loading) -> Boot:
    """Return what to start with: the live bundle, failing that the one before it, failing that the factory's.

    A bundle that was damaged on the disk or that this software cannot run is left behind, and the shelf says so.
    """
    state = kept = shelf.state()
    notes = list(shelf.notes)
    while not state.live.from_factory:
        try:
            model = loading.from_folder(shelf.folder_of(state.live))
        except (BundleError, FeatureTableError) as error:
            notes.append(f"bundle {state.live.bundle_id} cannot be used: {error}")
            state = _without_live(state)
        else:
            return Boot(model, state, tuple(notes), left_behind=bool(notes))
    left_behind = state != kept or bool(notes)
    try:
        return Boot(loading.factory(), state, tuple(notes), left_behind=left_behind)
    except (BundleError, FeatureTableError) as error:
        notes.append(f"the bundle of the settings cannot be used: {error}")
        return Boot(None, state, tuple(notes), left_behind=left_behind)


def _without_live(state: RolloutState) -> RolloutState:
    """Return the state after the live bundle was found unusable before anything was loaded."""
    newest = state.newest_sequence_number
    return rolled_back(state) if state.previous is not None else RolloutState(newest_sequence_number=newest)
