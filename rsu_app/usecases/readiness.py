"""Whether the unit can do its work right now, and if not, why. It never says yes out of politeness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roadgrip.bundle import GOLDEN_TOLERANCE_MU, GOLDEN_TOLERANCE_RATIO, ModelManifest
from roadgrip.errors import BundleError, StoreError
from roadgrip.records import FrictionInterval
from rsu_app.ports import Clock, FrictionModel, PassageStore

EARLIEST_SANE_UNIX_S = 1_704_067_200.0
"""2024-01-01: a wall clock before it has lost its battery."""
STEP_TOLERANCE_S = 2.0
"""Wall and monotonic clock drift apart by less than this between two looks, unless somebody set the wall clock."""
STEP_MEMORY_S = 60.0
"""How long a step is held against the clock; a unit whose clock was just corrected must not stay unready."""


@dataclass(frozen=True, slots=True)
class Check:
    """One thing the unit needs.

    Attributes:
        name: "model", "store", "clock" or "window".
        ok: Whether it is as it should be.
        detail: What was found, for a person.
        required: Whether the unit is unready without it; the window is for information.
    """

    name: str
    ok: bool
    detail: str
    required: bool = True


@dataclass(frozen=True, slots=True)
class Readiness:
    """All checks, and what follows from them."""

    checks: tuple[Check, ...]

    @property
    def ready(self) -> bool:
        """Whether everything required is as it should be."""
        return all(check.ok for check in self.checks if check.required)

    def conditions(self) -> dict[str, bool]:
        """Return whether everything of a name is as it should be, by name."""
        found: dict[str, bool] = {}
        for check in self.checks:
            found[check.name] = found.get(check.name, True) and check.ok
        return found


def check_golden(model: FrictionModel) -> None:
    """Do nothing if every model of a bundle answers its golden vectors as it did in the laboratory.

    Raises:
        BundleError: One does not; the message says by how much.
    """
    for manifest in model.manifest.models:
        _check_golden(model, manifest)


def _check_golden(model: FrictionModel, manifest: ModelManifest) -> None:
    subject, golden = f"bundle {model.manifest.bundle_id}", manifest.golden
    if not golden.rows:
        raise BundleError(f"{subject} has no golden vectors; nobody can say what its model should answer")
    try:
        answers = model.estimate(
            manifest.table_digest, np.asarray(golden.rows, dtype=np.float64), section_id=manifest.section_id
        )
    except ValueError as error:
        raise BundleError(f"{subject} has golden vectors that cannot be: {error}") from error
    known = (
        ("friction", answers.mu, golden.mu, GOLDEN_TOLERANCE_MU),
        ("expected error", answers.expected_error_ratio, golden.expected_error_ratio, GOLDEN_TOLERANCE_RATIO),
    )
    for quantity, found, wanted, tolerance in known:
        if (found is None) != (wanted is None):
            raise BundleError(f"{subject} gives an {quantity} and has no golden vectors for it, or the other way round")
        if found is None or wanted is None:
            continue
        difference = float(np.abs(found - np.asarray(wanted)).max())
        if not difference <= tolerance:
            raise BundleError(
                f"{subject} misses its {len(golden.rows)} golden vectors of {quantity} by {difference:.2e}"
            )


def model_check(model: FrictionModel | None, *, absence: str) -> Check:
    """Return whether there is a model and it still answers its golden vectors.

    Args:
        model: The live one, if there is one.
        absence: Why there is none, if there is none.
    """
    if model is None:
        return Check("model", ok=False, detail=absence)
    try:
        check_golden(model)
    except BundleError as error:
        return Check("model", ok=False, detail=str(error))
    return Check("model", ok=True, detail=f"bundle {model.manifest.bundle_id} answers its golden vectors")


def window_check(section_id: str, interval: FrictionInterval | None) -> Check:
    """Return whether vehicles told of a section lately; a quiet road is no fault, so nothing rests on it."""
    subject = f"section {section_id}"
    if interval is None:
        return Check("window", ok=False, detail=f"{subject}: no vehicle in the window", required=False)
    detail = f"{subject}: {interval.passages_count} vehicles, the newest {interval.newest_age_s:.0f} s ago"
    return Check("window", ok=interval.valid_for_s > 0.0, detail=detail, required=False)


async def store_check(store: PassageStore) -> Check:
    """Return whether a write reaches the disk."""
    try:
        await store.probe()
    except StoreError as error:
        return Check("store", ok=False, detail=str(error))
    return Check("store", ok=True, detail="; ".join(("writes reach the disk", *store.notes)))


@dataclass(frozen=True, slots=True)
class ClockSteps:
    """How often the wall clock was set while somebody looked.

    Attributes:
        steps_count: So often.
        last_step_s: By how much the last time, forwards positive; 0 without one.
        last_ago_s: How long ago that was seen; None without one.
        moved_s: How far it has moved against the monotonic clock in all, slow corrections included.
    """

    steps_count: int
    last_step_s: float
    last_ago_s: float | None
    moved_s: float


class ClockWatch:
    """Looks at the wall clock again and again, and says whether it can be believed.

    Args:
        clock: Both clocks of the unit.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._offset_s = self._first_offset_s = clock.unix_s() - clock.monotonic_s()
        self._steps_count = 0
        self._stepped_at_s: float | None = None
        self._step_s = 0.0

    def check(self) -> Check:
        """Return whether the wall clock names a possible year and did not step within the last minute."""
        unix_s, monotonic_s = self._clock.unix_s(), self._clock.monotonic_s()
        step_s = unix_s - monotonic_s - self._offset_s
        if abs(step_s) > STEP_TOLERANCE_S:
            self._stepped_at_s, self._step_s = monotonic_s, step_s
            self._steps_count += 1
        self._offset_s = unix_s - monotonic_s
        if unix_s < EARLIEST_SANE_UNIX_S:
            return Check("clock", ok=False, detail=f"the wall clock says {unix_s:.0f} s since 1970, before 2024")
        if self._stepped_at_s is not None and monotonic_s - self._stepped_at_s < STEP_MEMORY_S:
            return Check("clock", ok=False, detail=f"the wall clock stepped by {self._step_s:.1f} s a moment ago")
        return Check("clock", ok=True, detail="the wall clock is plausible and steady")

    @property
    def steps(self) -> ClockSteps:
        """How often the wall clock was set, as far as `check` has seen."""
        ago_s = None if self._stepped_at_s is None else self._clock.monotonic_s() - self._stepped_at_s
        return ClockSteps(self._steps_count, self._step_s, ago_s, moved_s=self._offset_s - self._first_offset_s)

    @property
    def plausible(self) -> bool:
        """Whether the wall clock names a possible year."""
        return self._clock.unix_s() >= EARLIEST_SANE_UNIX_S
