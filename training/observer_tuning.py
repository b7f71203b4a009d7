"""The constants of the onboard estimation, fitted to drives whose sideslip is known: they belong to a vehicle.

The paper's were found the same way, for its car. The estimation that is fitted is the vehicle's own, and what is
judged was not fitted to.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from roadgrip.errors import ConfigurationError
from roadgrip.units import FloatArray
from training.reference_drives import ReferenceDrive
from vehicle_client.estimation.observer import XC90_PARAMETERS, ObserverParameters
from vehicle_client.estimation.signals import kinematic_signals

RANGE_FACTOR = 20.0
"""How many times less or more than the paper's a constant may become."""
_NOT_ABOUT_SIDESLIP = ("accel_x_threshold_mps2", "sigma_wheel_steady_mps2", "sigma_wheel_accelerating_mps2")
"""The wheels' weights: they make the speed, and are better judged by it."""
_SPREAD_FRAC = 0.2
"""How far from the start the search begins, of each constant's range."""
_FEWEST_MEMBERS_COUNT = 8
_STEP_FRAC = 0.08
"""First step of the descent."""
_AT_BOUND_FRAC = 0.005
_IDLE_RATIO = 0.002
"""A change that brings less than this share of the error is none."""


@dataclass(frozen=True, slots=True)
class ConstantRange:
    """Between what a constant may lie, and whether its logarithm is what counts.

    Attributes:
        low: Smallest value.
        high: Largest value.
        logarithmic: Whether factors count, not differences; both bounds are then positive.
    """

    low: float
    high: float
    logarithmic: bool = True

    def share(self, value: float) -> float:
        """Return how far along the range a value lies, from 0 to 1."""
        low, high, at = (math.log(v) if self.logarithmic else v for v in (self.low, self.high, value))
        return (at - low) / (high - low)

    def value(self, share: float) -> float:
        """Return the value so far along the range."""
        within = min(max(share, 0.0), 1.0)
        if not self.logarithmic:
            return self.low + within * (self.high - self.low)
        return math.exp(math.log(self.low) + within * (math.log(self.high) - math.log(self.low)))


_SHARES = {"grip_pull_ratio": ConstantRange(0.0, 2.0, logarithmic=False)}
"""Ranges of constants that may be zero: a factor would never lead there."""


@dataclass(frozen=True, slots=True)
class Judgement:
    """How well a sideslip is estimated.

    Attributes:
        rms_rad: Of the error.
        truth_rms_rad: Of the sideslip itself: the error of claiming that there is none.
        correlation: With the truth; zero where either is constant.
        judged_s: How long it was judged.
    """

    rms_rad: float
    truth_rms_rad: float
    correlation: float
    judged_s: float


@dataclass(frozen=True, slots=True)
class Found:
    """What a search found.

    Attributes:
        parameters: The best constants; those it started from if nothing was better.
        evaluations_count: How many sets of constants were tried.
        at_bounds: Names of constants that ended at a bound of their range.
    """

    parameters: ObserverParameters
    evaluations_count: int
    at_bounds: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Tuning:
    """What a search found, judged on what it saw and on what it did not see.

    Attributes:
        start: The constants it began with.
        found: What it came to.
        tuned: How well the drives that it saw are estimated, before and after.
        held_out: The same of drives that it did not see; None if there were none.
    """

    start: ObserverParameters
    found: Found
    tuned: tuple[Judgement, Judgement]
    held_out: tuple[Judgement, Judgement] | None

    @property
    def improved(self) -> bool:
        """Whether what was held out became better; if nothing was, whether what was tuned on did."""
        before, after = self.held_out or self.tuned
        return after.rms_rad < before.rms_rad

    @property
    def kept(self) -> ObserverParameters:
        """The constants to go on with: what was found if it is an improvement, else those it began with."""
        return self.found.parameters if self.improved else self.start


OnEvaluation = Callable[[int, float], None]


def _ignored(_count: int, _best_rad: float) -> None:
    """Do nothing."""


def tunable_ranges(start: ObserverParameters = XC90_PARAMETERS) -> dict[str, ConstantRange]:
    """Return the constants that can be tuned, each with its range; wide enough for where it starts."""
    ranges = {}
    for field in fields(ObserverParameters):
        usual, at = getattr(XC90_PARAMETERS, field.name), getattr(start, field.name)
        if not isinstance(usual, float):
            continue
        if field.name in _SHARES:
            share = _SHARES[field.name]
            ranges[field.name] = replace(share, low=min(share.low, at), high=max(share.high, at))
        elif usual > 0.0 and at > 0.0:
            ranges[field.name] = ConstantRange(min(usual / RANGE_FACTOR, at), max(usual * RANGE_FACTOR, at))
    return ranges


def usual_constants() -> tuple[str, ...]:
    """Return the names of the constants that are tuned if none is named."""
    return tuple(name for name in tunable_ranges() if name not in _NOT_ABOUT_SIDESLIP)


def judgement(drives: Sequence[ReferenceDrive], parameters: ObserverParameters) -> Judgement:
    """Return how well the onboard estimation with some constants tells the sideslip of some drives, all together.

    Args:
        drives: At least one.
        parameters: The constants.
    """
    truth = np.concatenate([drive.sideslip_rad[drive.judged] for drive in drives])
    found = np.concatenate([estimated_sideslip_rad(drive, parameters)[drive.judged] for drive in drives])
    varies = float(np.std(truth)) > 0.0 and float(np.std(found)) > 0.0
    return Judgement(
        rms_rad=_rms(found - truth),
        truth_rms_rad=_rms(truth),
        correlation=float(np.corrcoef(found, truth)[0, 1]) if varies else 0.0,
        judged_s=sum(drive.judged_s for drive in drives),
    )


def estimated_sideslip_rad(drive: ReferenceDrive, parameters: ObserverParameters) -> FloatArray:
    """Return what the vehicle would make of a drive with some constants. (n,)"""
    return kinematic_signals(
        drive.trace,
        drive.section,
        station_m=drive.station_m,
        vehicle=drive.vehicle,
        parameters=parameters,
        offsets=drive.offsets,
    ).sideslip_rad


def tune(
    tuned_on: Sequence[ReferenceDrive],
    held_out: Sequence[ReferenceDrive],
    start: ObserverParameters,
    *,
    constants: Sequence[str],
    evaluations_limit_count: int,
    seed: int,
    on_evaluation: OnEvaluation = _ignored,
) -> Tuning:
    """Return the constants that fit some drives best, judged on others; for the arguments see `best_parameters`.

    Args:
        tuned_on: At least one.
        held_out: Never seen by the search; may be empty.
        start: Where the search begins.
        constants: Names of what may change.
        evaluations_limit_count: How many sets of constants may be tried.
        seed: Of the search.
        on_evaluation: Called with the number of sets tried and the least error so far, in rad.

    Raises:
        ConfigurationError: A constant cannot be tuned.
    """
    found = best_parameters(
        tuned_on,
        start,
        constants=constants,
        evaluations_limit_count=evaluations_limit_count,
        seed=seed,
        on_evaluation=on_evaluation,
    )

    def before_and_after(drives: Sequence[ReferenceDrive]) -> tuple[Judgement, Judgement]:
        return judgement(drives, start), judgement(drives, found.parameters)

    return Tuning(start, found, before_and_after(tuned_on), before_and_after(held_out) if held_out else None)


def best_parameters(
    drives: Sequence[ReferenceDrive],
    start: ObserverParameters,
    *,
    constants: Sequence[str],
    evaluations_limit_count: int,
    seed: int,
    on_evaluation: OnEvaluation = _ignored,
) -> Found:
    """Return the constants with the least RMS error of sideslip over some drives.

    Half of the evaluations go to a differential evolution that begins around the start, the rest to a simplex descent
    from its best; at last, constants whose change brought nothing go back to their start. The same drives, start and
    seed give the same constants.

    Args:
        drives: What is tuned on, at least one.
        start: Where the search begins; constants that are not named keep these values.
        constants: Names of what may change.
        evaluations_limit_count: How many sets of constants may be tried.
        seed: Of the evolution.
        on_evaluation: Called with the number of sets tried and the least error so far, in rad.

    Raises:
        ConfigurationError: A constant cannot be tuned; the message lists those that can.

    References:
        Storn and Price, Differential Evolution, J. of Global Optimization 11 (1997); Nelder and Mead, A simplex method
        for function minimization, The Computer Journal 7 (1965).
    """
    # Here, since the other commands of the laboratory need no optimiser and it takes its time to import.
    from scipy.optimize import Bounds, differential_evolution, minimize

    ranges = tunable_ranges(start)
    unknown = sorted(set(constants) - set(ranges))
    if unknown or not constants:
        raise ConfigurationError(f"cannot tune {', '.join(unknown) or 'nothing'}; there are {', '.join(ranges)}")
    search = _Search(drives, start, {name: ranges[name] for name in constants}, on_evaluation)
    begin = search.shares_of(start)
    whole_ranges = Bounds(np.zeros(len(begin)), np.ones(len(begin)))
    search.error_rad(begin)
    members_count = max(_FEWEST_MEMBERS_COUNT, 2 * len(begin))
    generations_count = evaluations_limit_count // 2 // members_count
    if generations_count >= 2:
        chance = np.random.default_rng(seed)
        around = begin + _SPREAD_FRAC * chance.standard_normal((members_count, len(begin)))
        around[0] = begin
        differential_evolution(
            search.error_rad,
            whole_ranges,
            init=np.clip(around, 0.0, 1.0),
            maxiter=generations_count - 1,
            polish=False,
            tol=0.0,
            rng=chance,
        )
    remaining_count = evaluations_limit_count - search.evaluations_count - len(begin)
    if remaining_count > len(begin) + 1:
        best = search.best_shares
        # Away from the nearer bound, so that no corner of the first simplex is flattened.
        steps = np.diag(np.where(best > 0.5, -_STEP_FRAC, _STEP_FRAC))
        minimize(
            search.error_rad,
            best,
            method="Nelder-Mead",
            bounds=whole_ranges,
            options={
                "maxfev": remaining_count,
                "initial_simplex": np.vstack([best, best + steps]),
                "adaptive": True,
                "xatol": 1e-3,
                "fatol": 1e-7,
            },
        )
    best = search.best_shares
    if evaluations_limit_count - search.evaluations_count >= len(begin):
        best = _without_idle(search, begin)
    shares = dict(zip(constants, best.tolist(), strict=True))
    moved = bool(np.any(best != begin))
    return Found(
        parameters=search.parameters_at(best) if moved else start,
        evaluations_count=search.evaluations_count,
        at_bounds=tuple(
            name
            for name, share in shares.items()
            if moved and (share > 1.0 - _AT_BOUND_FRAC or (share < _AT_BOUND_FRAC and ranges[name].low != 0.0))
        ),
    )


def _without_idle(search: _Search, begin: FloatArray) -> FloatArray:
    """Return the best shares with those constants back at their start whose change brought nothing.

    A roll gradient changes nothing in a car with a roll gyro: it shall not come out as what the search left it at.
    """
    kept = search.best_shares.copy()
    allowed_rad = search.best_rad * (1.0 + _IDLE_RATIO)
    for i in range(len(begin)):
        back = kept.copy()
        back[i] = begin[i]
        if search.error_rad(back) <= allowed_rad:
            kept = back
    return kept


class _Search:
    """The error as a function of shares of ranges, with the best that was seen."""

    def __init__(
        self,
        drives: Sequence[ReferenceDrive],
        start: ObserverParameters,
        ranges: dict[str, ConstantRange],
        on_evaluation: OnEvaluation,
    ) -> None:
        self._drives = drives
        self._start = start
        self._ranges = ranges
        self._on_evaluation = on_evaluation
        self.best_rad = math.inf
        self.evaluations_count = 0
        self.best_shares: FloatArray = self.shares_of(start)

    def shares_of(self, parameters: ObserverParameters) -> FloatArray:
        return np.array([within.share(getattr(parameters, name)) for name, within in self._ranges.items()])

    def parameters_at(self, shares: FloatArray) -> ObserverParameters:
        values: dict[str, Any] = {
            name: within.value(float(share)) for (name, within), share in zip(self._ranges.items(), shares, strict=True)
        }
        return replace(self._start, **values)

    def error_rad(self, shares: FloatArray) -> float:
        error = judgement(self._drives, self.parameters_at(shares)).rms_rad
        error = error if math.isfinite(error) else math.pi
        self.evaluations_count += 1
        if error < self.best_rad:
            self.best_rad, self.best_shares = error, np.array(shares, dtype=np.float64)
        self._on_evaluation(self.evaluations_count, self.best_rad)
        return error


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
