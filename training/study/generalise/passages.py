"""What a window of vehicles says about one road, drawn from what is assumed, for rules to be tried on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roadgrip.bundle import Conformal
from roadgrip.units import BoolArray, FloatArray
from rsu_app.domain.interval import WORN_TYRE_RATIO
from rsu_app.domain.wear import NOISE_PER_EXPECTED_ERROR_RATIO
from training.regressor import RowIndices


@dataclass(frozen=True, slots=True)
class Passages:
    """What the vehicles of a window said.

    Attributes:
        mu: Estimates, and lower bounds where `at_least`. (n,)
        expected_error_ratio: Mean relative error to expect of each; NaN where nothing is known. (n,)
        at_least: Which are bounds. (n,)
    """

    mu: FloatArray
    expected_error_ratio: FloatArray
    at_least: BoolArray

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.mu)

    def rows(self, rows: RowIndices) -> Passages:
        """Return some of them, maybe more than once."""
        return Passages(self.mu[rows], self.expected_error_ratio[rows], self.at_least[rows])

    def with_bounds(self, meant: Conformal) -> Passages:
        """Return the same with doubtful estimates taken for the lower bounds they give, as a unit takes them.

        Args:
            meant: What the bundle makes of expected errors.
        """
        doubtful = self.expected_error_ratio > meant.doubtful_above_ratio
        bound_mu = self.mu * np.exp(-meant.quantile * self.expected_error_ratio)
        # A bound has its allowance for errors in it.
        return Passages(
            mu=np.where(doubtful, bound_mu, self.mu),
            expected_error_ratio=np.where(doubtful, 0.0, self.expected_error_ratio),
            at_least=doubtful,
        )


@dataclass(frozen=True, slots=True)
class Traffic:
    """What is assumed of the vehicles.

    Attributes:
        lowest_noise_ratio: Standard deviation of the relative error of the most exact vehicles.
        highest_noise_ratio: Of the least exact ones; evenly spread in between, and known to the rules.
        outlier_frac: Share of estimates that lie anywhere between 0.05 and 1.2.
        shy_frac: Share of vehicles that need little grip: 0.5 to 1.1 times what a new tyre finds, evenly. Those that
            need less than there is only know that there is as much.
        road_bias_ratio: Standard deviation of a relative error that all vehicles share.
    """

    lowest_noise_ratio: float = 0.02
    highest_noise_ratio: float = 0.08
    outlier_frac: float = 0.03
    shy_frac: float = 0.0
    road_bias_ratio: float = 0.0


def drawn_passages(rng: np.random.Generator, count: int, *, mu_new: float, traffic: Traffic) -> Passages:
    """Return what vehicles say about a road.

    Args:
        rng: Source of chance.
        count: Vehicles.
        mu_new: Friction a new tyre finds.
        traffic: What is assumed of the vehicles.
    """
    noise_ratio = rng.uniform(traffic.lowest_noise_ratio, traffic.highest_noise_ratio, count)
    found_mu = mu_new * rng.uniform(WORN_TYRE_RATIO, 1.0, count)
    shy = rng.random(count) < traffic.shy_frac
    needed_mu = np.where(shy, mu_new * rng.uniform(0.5, 1.1, count), np.inf)
    at_least = needed_mu < found_mu
    error_ratio = noise_ratio * rng.standard_normal(count) + traffic.road_bias_ratio * rng.standard_normal()
    said_mu = np.minimum(found_mu, needed_mu) * np.exp(error_ratio)
    strange = rng.random(count) < traffic.outlier_frac
    mu = np.where(strange, rng.uniform(0.05, 1.2, count), said_mu)
    return Passages(mu, noise_ratio / NOISE_PER_EXPECTED_ERROR_RATIO, at_least & ~strange)
