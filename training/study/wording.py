"""Words for figures in verdicts: always per cent, always the grade of the sensors beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from training.study.chapter import Result
from vehicle_client.simulator.plan import SensorGrade


def per_cent_words(share_frac: float) -> str:
    """Return a share in words for a sentence: three digits, such as "4.83 %"."""
    return f"{100.0 * share_frac:.3g} %"


def leading_grade(results: Mapping[SensorGrade, Result]) -> SensorGrade:
    """Return the grade that the paper is set against: ideal sensors, its own, if there are results for them."""
    return SensorGrade.IDEAL if SensorGrade.IDEAL in results else next(iter(results))


def by_grade(results: Mapping[SensorGrade, Result], figure: str) -> str:
    """Return one figure for every grade there is, such as "4.83 % (ideal), 9.58 % (automotive)"."""
    return ", ".join(f"{per_cent_words(results[g].figures[figure])} ({g})" for g in SensorGrade if g in results)


def listed(names: Sequence[str]) -> str:
    """Return names as a sentence lists them: "a, b and c"; "nothing" for none."""
    if not names:
        return "nothing"
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
