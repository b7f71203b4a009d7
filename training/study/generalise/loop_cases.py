"""Which units are compared in the closed loop: what their model was taught, by what rule they advise, who obeys."""

from __future__ import annotations

from dataclasses import dataclass

from rsu_app.domain.advisory import AdvisoryPolicy
from rsu_app.domain.change import ChangePolicy
from rsu_app.domain.pooling import PoolingPolicy
from rsu_app.domain.probing import ProbingPolicy
from rsu_app.domain.profiles import ProfilePolicy
from training.loop_unit import UnitRules
from training.study.generalise.loop_model import DATA_SETS, USUAL_SETS, Teaching
from training.study.recipes import BEST_RECIPE, PAPER_RECIPE, SPEED_ONLY_RECIPE

FRICTIONS_MU = (0.5, 0.2, 0.5)
PHASE_NAMES = ("dry", "slippery", "dry_again")
SLIPPERY = 1
"""Which of them is slippery."""
POLICY = AdvisoryPolicy()

PAPER = "paper"
BEST = "best"
BOXED = "best, in a box"
USUAL = "best, taught usual drives"
SPEED = "speed only"
TEACHINGS: tuple[Teaching, ...] = (
    Teaching(PAPER, PAPER_RECIPE, USUAL_SETS),
    Teaching(BEST, BEST_RECIPE, DATA_SETS),
    Teaching(USUAL, BEST_RECIPE, USUAL_SETS),
    Teaching(BOXED, BEST_RECIPE, USUAL_SETS, in_a_box=True),
    Teaching(SPEED, SPEED_ONLY_RECIPE, USUAL_SETS),
)
"""The best one learns from drives at any speed as well, as a bundle does. The last one is a warning: it knows nothing
but speeds."""

MEDIAN = "median"
HELD = "median, held while unknown"
HELD_CUT = "median, held while unknown, cut at changes"
REFINED_CUT = "refined, cut at changes"
LIKELIHOODS = "likelihoods, cut at changes"
RULES: dict[str, UnitRules] = {
    MEDIAN: UnitRules(advisory=POLICY),
    HELD: UnitRules(advisory=POLICY, probing=ProbingPolicy()),
    HELD_CUT: UnitRules(advisory=POLICY, probing=ProbingPolicy(), change=ChangePolicy()),
    REFINED_CUT: UnitRules(advisory=POLICY, change=ChangePolicy(), pooling=PoolingPolicy()),
    LIKELIHOODS: UnitRules(advisory=POLICY, change=ChangePolicy(), pooling=ProfilePolicy()),
}
"""What advice rests on. A road side unit holds it while the friction is unknown; the others show what that is for."""

COMPLIANCES_FRAC = (0.0, 0.5, 1.0)
NEARLY_ALL_FRAC = 0.9
WRONG_RATIOS = (0.7, 1.3)


@dataclass(frozen=True, slots=True)
class Setting:
    """A case before its model is taught.

    Attributes:
        teaching: Name of what its model was taught.
        rule: Name of what advice rests on.
        compliance_frac: Share of the drivers who follow.
        told_ratio: Speed they are told over the one the unit means.
    """

    teaching: str
    rule: str
    compliance_frac: float
    told_ratio: float = 1.0

    @property
    def name(self) -> str:
        """One of its kind."""
        told = "" if self.told_ratio == 1.0 else f" told {self.told_ratio:g}"
        return f"{self.teaching} | {self.rule} | {100.0 * self.compliance_frac:.0f} %{told}"

    @property
    def right(self) -> Setting:
        """The same where drivers are told what the unit means."""
        return Setting(self.teaching, self.rule, self.compliance_frac)


def _all_obey(teaching: str, rule: str) -> tuple[Setting, ...]:
    return tuple(Setting(teaching, rule, 1.0, ratio) for ratio in WRONG_RATIOS)


QUICK_SETTINGS: tuple[Setting, ...] = (
    *(Setting(BEST, rule, share) for rule in (MEDIAN, HELD, HELD_CUT) for share in COMPLIANCES_FRAC),
    *(Setting(teaching, MEDIAN, share) for teaching in (USUAL, PAPER, BOXED) for share in COMPLIANCES_FRAC[-1:]),
    *(setting for rule in (MEDIAN, HELD, HELD_CUT) for setting in _all_obey(BEST, rule)),
)
SETTINGS: tuple[Setting, ...] = (
    *(Setting(BEST, rule, share) for rule in RULES for share in (*COMPLIANCES_FRAC[:2], NEARLY_ALL_FRAC, 1.0)),
    *(Setting(teaching, MEDIAN, share) for teaching in (USUAL, PAPER) for share in COMPLIANCES_FRAC),
    *(Setting(BOXED, MEDIAN, share) for share in COMPLIANCES_FRAC[1:]),
    Setting(SPEED, MEDIAN, 1.0),
    *(Setting(BEST, HELD, 0.5, ratio) for ratio in WRONG_RATIOS),
    *(setting for teaching in (BEST, USUAL, PAPER, SPEED) for setting in _all_obey(teaching, MEDIAN)),
    *(setting for rule in RULES if rule != MEDIAN for setting in _all_obey(BEST, rule)),
)
