"""What one passage says about friction, from what the models of a bundle answered for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

from roadgrip.bundle import ModelManifest
from roadgrip.records import NotCounted
from roadgrip.units import FloatArray
from rsu_app.domain.plausibility import are_strange, estimate_flag, together


@dataclass(frozen=True, slots=True)
class Judgement:
    """What one passage says.

    Attributes:
        mu: The estimate, or None when the model gave no number.
        flags: Why it does not count, if it does not.
        expected_error_ratio: Size of the error to expect, relative to the estimate; None when the bundle has no
            model for it.
        mu_low: Below this the friction hardly is, with the coverage the bundle promises; None without an expected
            error.
        at_least: The estimate is doubtful: the passage only says that the friction is at least `mu_low`.
    """

    mu: float | None
    flags: NotCounted
    expected_error_ratio: float | None = None
    mu_low: float | None = None
    at_least: bool = False


def judgement(
    row: FloatArray, manifest: ModelManifest, *, mu: float, expected_error_ratio: float | None = None
) -> Judgement:
    """Return what a passage says.

    Args:
        row: Its features in the order of the model's table. (columns,)
        manifest: What the model says about itself.
        mu: What the friction model answered.
        expected_error_ratio: What the model for the expected error answered; None without one.
    """
    errors = None if expected_error_ratio is None else [expected_error_ratio]
    return judgements(row[None, :], manifest, mu=[mu], expected_error_ratio=errors)[0]


def judgements(
    rows: FloatArray, manifest: ModelManifest, *, mu: Sequence[float], expected_error_ratio: Sequence[float] | None
) -> list[Judgement]:
    """Return what each of many passages says; arguments as for `judgement`, a row or number for each passage."""
    errors = [None] * len(mu) if expected_error_ratio is None else expected_error_ratio
    return [
        _judged(mu[i], errors[i], manifest, NotCounted.OUT_OF_ENVELOPE if strange else NotCounted.NONE)
        for i, strange in enumerate(are_strange(rows, manifest).tolist())
    ]


def _judged(mu: float, expected_error_ratio: float | None, manifest: ModelManifest, flags: NotCounted) -> Judgement:
    flags = together(flags, estimate_flag(mu, manifest))
    if not isfinite(mu):
        return Judgement(mu=None, flags=flags)
    if expected_error_ratio is None or manifest.conformal is None:
        return Judgement(mu=mu, flags=flags)
    if not (isfinite(expected_error_ratio) and expected_error_ratio > 0.0):
        # A model that expects no error, or less than none, is as lost as one that answers an impossible friction.
        return Judgement(mu=mu, flags=flags | NotCounted.ESTIMATE_OUT_OF_RANGE)
    return Judgement(
        mu=mu,
        flags=flags,
        expected_error_ratio=expected_error_ratio,
        mu_low=manifest.conformal.mu_low(mu, expected_error_ratio=expected_error_ratio),
        at_least=manifest.conformal.at_least(expected_error_ratio=expected_error_ratio),
    )
