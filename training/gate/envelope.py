"""Whether a bundle knows what it was made for: ordinary drives are seldom called strange, manoeuvres nearly always."""

from __future__ import annotations

from training.gate.contender import Case
from training.gate.thresholds import MANOEUVRES_ROLE, ORDINARY_ROLES, EnvelopeThresholds
from training.gate.verdict import Check, check_of


def envelope(case: Case, limits: EnvelopeThresholds) -> Check | None:
    """Return whether as many drives are called strange as should be; None for a hold-out that is neither.

    Args:
        case: A hold-out and what is said of it.
        limits: What is asked.
    """
    share = float(case.challenger.strange.mean())
    figures = {"strange_frac": share}
    if case.champion is not None:
        figures["champion_strange_frac"] = float(case.champion.strange.mean())
    if case.role in ORDINARY_ROLES:
        limit, passed, word = limits.ordinary_frac, share <= limits.ordinary_frac, "most"
    elif case.role == MANOEUVRES_ROLE:
        limit, passed, word = limits.manoeuvres_frac, share >= limits.manoeuvres_frac, "least"
    else:
        return None
    return check_of(
        "envelope",
        case.title,
        passed=passed,
        figures=figures,
        limits={"strange_frac": limit},
        sentence=f"{100 * share:.1f} % of the drives are called strange, {100 * limit:g} % at {word}",
    )
