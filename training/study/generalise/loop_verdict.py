"""What to make of the closed loop, in words that follow the figures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from training.study.chapter import Claim, Result, Verdict
from training.study.folds import RANDOM_ROADS_SET
from training.study.generalise.loop_cases import (
    BEST,
    BOXED,
    FRICTIONS_MU,
    HELD,
    HELD_CUT,
    MEDIAN,
    PAPER,
    PHASE_NAMES,
    REFINED_CUT,
    SETTINGS,
    USUAL,
    WRONG_RATIOS,
    Setting,
)
from training.study.generalise.loop_measures import KNOWN_WITHIN_FRAC, farthest, largest
from training.study.generalise.loop_model import ANY_SPEED_SET
from training.study.wording import by_grade, leading_grade, per_cent_words
from vehicle_client.simulator.plan import SensorGrade

CONFIRMS_ABOVE_FRAC = 0.1
"""A wrong advice confirms itself if it moves the published friction by more, in the direction of the lie."""
LOCKED_BELOW_RATIO = 0.7
"""Advice below this share of the right one is locked in; rounding down by 5 km/h alone may cost a seventh of it."""
COUNTED_FRAC = 0.95
"""So many of the summaries of obedient drivers must count."""
LIED_TO = ((BEST, MEDIAN), (BEST, HELD), (BEST, HELD_CUT), (PAPER, MEDIAN))
"""Models and rules of which the verdict tells what a wrong advice makes of them; tables tell of all."""


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Say who counts, what is found and advised, and whether a lie comes true."""
    # A car on the road has no ideal sensors, and what is advised is for cars on the road.
    grade = SensorGrade.AUTOMOTIVE if SensorGrade.AUTOMOTIVE in results else leading_grade(results)
    figures = results[grade].figures
    left = [
        _figure(figures, f"{Setting(BEST, HELD, share).name}.slippery.worst_left_road") for share in (0.0, 0.5, 1.0)
    ]
    text = (
        _counted_words(results, grade)
        + _found_words(results)
        + f"The following is told of {grade} sensors. "
        + _held_words(figures)
        + _lie_words(figures)
        + f"On slippery road {per_cent_words(left[0])} of the vehicles leave it where nobody obeys, "
        f"{per_cent_words(left[1])} where half do, {per_cent_words(left[2])} where all do."
    )
    return Verdict(Claim.NOT_CLAIMED, text)


def _figure(figures: Mapping[str, float], name: str) -> float:
    """Return a figure, NaN for a setting that a quick study leaves out."""
    return figures.get(name, np.nan)


def _counted_words(results: Mapping[SensorGrade, Result], grade: SensorGrade) -> str:
    figures = results[grade].figures
    least = {of: _least_counted(results[of].figures, BEST) for of in results}
    words = ", ".join(f"{per_cent_words(value)} ({of})" for of, value in least.items())
    enough = "they stay inside the envelope" if min(least.values()) >= COUNTED_FRAC else "still too few"
    return (
        "Obedient drivers are slow, and a model that never met such takes them for strange: of their summaries "
        f"{per_cent_words(_least_counted(figures, USUAL))} count at worst if it was taught usual drives alone "
        f"({grade}), {per_cent_words(_least_counted(figures, BOXED))} by a box of the features' extremes. Taught "
        f"drives at any speed as well, as a bundle is, {words} count at worst: {enough}. The best model "
        f"then errs by {by_grade(results, f'{BEST}.{ANY_SPEED_SET}.mape')} on such drives that it did not see, not "
        f"{by_grade(results, f'{USUAL}.{ANY_SPEED_SET}.mape')}, and on usual drives of unseen roads by "
        f"{by_grade(results, f'{BEST}.{RANDOM_ROADS_SET}.mape')}, not "
        f"{by_grade(results, f'{USUAL}.{RANDOM_ROADS_SET}.mape')}. "
    )


def _least_counted(figures: Mapping[str, float], teaching: str) -> float:
    """Return the share of the summaries that count where all obey, in the worst phase of the worst setting."""
    known = [
        value
        for setting in SETTINGS
        if setting.teaching == teaching and setting.compliance_frac == 1.0
        for phase in PHASE_NAMES
        if np.isfinite(value := _figure(figures, f"{setting.name}.{phase}.least_counted"))
    ]
    return min(known, default=np.nan)


def _found_words(results: Mapping[SensorGrade, Result]) -> str:
    told = []
    for share in (0.5, 1.0):
        by_rule = [
            f"{', '.join(_bias_words(results[of].figures, Setting(BEST, rule, share), of) for of in results)}{how}"
            for rule, how in ((HELD, " by the median"), (REFINED_CUT, " refined and cut at changes"))
            if all(
                f"{Setting(BEST, rule, share).name}.{PHASE_NAMES[0]}.worst_bias" in r.figures for r in results.values()
            )
        ]
        told.append(f"where {100.0 * share:.0f} % obey {'; '.join(by_rule)}")
    late = ", ".join(_lag_words(results[of].figures, rule, of) for rule in (HELD, HELD_CUT) for of in results)
    blind = [of for of in results if _is_blind(results[of].figures)]
    reason = (
        "Who obeys uses so little of the grip that he hardly feels how much there is: the better the advice is obeyed, "
        f"the less the unit knows ({', '.join(blind)}). "
        if blind
        else "Those who obey still use enough of the grip to know it. "
    )
    return (
        "Once settled, the middle of the interval is off at worst over phases and roads "
        f"{'. And '.join(told)}. With half of the drivers obeying, the drop to {FRICTIONS_MU[1]:g} is known after "
        f"{late}. {reason}"
    )


def _is_blind(figures: Mapping[str, float]) -> bool:
    return abs(_worst(figures, Setting(BEST, MEDIAN, 1.0), "worst_bias")) > KNOWN_WITHIN_FRAC


def _held_words(figures: Mapping[str, float]) -> str:
    """Return what advice comes to where all obey, without holding it while the friction is unknown and with."""
    slowest, fastest = (
        {
            rule: choose([_figure(figures, f"{Setting(BEST, rule, 1.0).name}.{phase}.{what}") for phase in PHASE_NAMES])
            for rule in (MEDIAN, HELD, HELD_CUT)
        }
        for what, choose in (("slowest_advice", min), ("fastest_advice", max))
    )
    locked = slowest[MEDIAN] < LOCKED_BELOW_RATIO
    freed = min(slowest[HELD], slowest[HELD_CUT]) >= LOCKED_BELOW_RATIO
    safe = max(fastest[HELD], fastest[HELD_CUT]) <= 1.0 + CONFIRMS_ABOVE_FRAC
    effect = ("gets out of it" if locked else "stays fast enough") if freed else "is still too slow"
    return (
        f"Where all obey, advice that takes every estimate for one falls to {slowest[MEDIAN]:.2f} of the right speed "
        f"at worst{', locked in by its own slowness' if locked else ''}. Held while too few name a friction and raised "
        f"step by step where vehicles show headroom, it {effect}: {slowest[HELD]:.2f} to {fastest[HELD]:.2f} of the "
        f"right speed, {slowest[HELD_CUT]:.2f} to {fastest[HELD_CUT]:.2f} with windows cut at changes, "
        f"{'never much' if safe else 'at times dangerously'} above it. "
    )


def _bias_words(figures: Mapping[str, float], setting: Setting, grade: SensorGrade) -> str:
    """Return what a unit claims wrongly, and how much of the time it claims nothing."""
    claimed, marked = _worst(figures, setting, "worst_claimed_bias"), _worst(figures, setting, "most_marked")
    if not np.isfinite(claimed):
        return f"nothing claimed ({grade})"
    often = f", up to {100.0 * marked:.0f} % of the time only a bound" if marked > 0.0 else ""
    return f"{100.0 * claimed:+.0f} % ({grade}{often})"


def _lag_words(figures: Mapping[str, float], rule: str, grade: SensorGrade) -> str:
    lag_s = figures[f"{Setting(BEST, rule, 0.5).name}.slippery.worst_lag_s"]
    return f"{lag_s / 60.0:.0f} min ({rule}, {grade})" if np.isfinite(lag_s) else f"never ({rule}, {grade})"


def _worst(figures: Mapping[str, float], setting: Setting, measure: str) -> float:
    return farthest([_figure(figures, f"{setting.name}.{phase}.{measure}") for phase in PHASE_NAMES])


def _lie_words(figures: Mapping[str, float]) -> str:
    words = []
    for teaching, rule in LIED_TO:
        if f"{Setting(teaching, rule, 1.0, WRONG_RATIOS[0]).name}.{PHASE_NAMES[0]}.claimed_towards_lie" not in figures:
            continue
        claimed, advised = (_towards_lie(figures, teaching, rule, what) for what in ("claimed", "advised"))
        who = f"{teaching}, {rule}"
        moved = f"the unit's own advice moves {100.0 * advised:+.0f} % towards the lie"
        if not np.isfinite(claimed):
            words.append(f"{who}: no friction is claimed, {moved}")
            continue
        confirmed = "confirms itself" if claimed > CONFIRMS_ABOVE_FRAC else "does not confirm itself"
        words.append(f"{who}: {confirmed} ({100.0 * claimed:+.0f} % towards the lie), {moved}")
    return f"An advice that all obey and that is wrong by 30 % on purpose, at worst: {'; '.join(words)}. "


def _towards_lie(figures: Mapping[str, float], teaching: str, rule: str, what: str) -> float:
    lies = [Setting(teaching, rule, 1.0, ratio) for ratio in WRONG_RATIOS]
    return largest([_figure(figures, f"{s.name}.{phase}.{what}_towards_lie") for s in lies for phase in PHASE_NAMES])
