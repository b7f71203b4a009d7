"""The headlines of the study: the few figures that others compare, and the object that machines read them from.

A chapter contributes one by a figure named `headline.CONFIG.NAME`, such as `headline.best.unseen_roads_mape`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from training.study.documents import in_short
from training.study.finding import Finding
from vehicle_client.simulator.plan import SensorGrade

PREFIX = "headline."
CONFIGS = ("paper_config", "best")
"""The paper's configuration (78 features, 100 trees, depth 6), and the best exportable model."""
EXTRA_CONFIGS = ("speed_only",)
"""Beside them where a chapter has it: the regressor that knows nothing but speeds, as a warning."""


@dataclass(frozen=True, slots=True)
class Headline:
    """One of the figures that every study must come to.

    Attributes:
        name: In `summary.json`; a fraction.
        meaning: For people.
        paper: What the paper has, in its words; empty where it does not ask.
        target_frac: What the best model should reach, by grade; missing without a target.
        at_least: Whether more is better.
    """

    name: str
    meaning: str
    paper: str = "not tested"
    target_frac: Mapping[SensorGrade, float] | None = None
    at_least: bool = False

    def is_reached(self, value: float | None, grade: SensorGrade) -> bool | None:
        """Return whether a figure meets the target; None without a target or a figure."""
        if value is None or self.target_frac is None or grade not in self.target_frac:
            return None
        target = self.target_frac[grade]
        return value >= target if self.at_least else value <= target


def _targets(*, ideal: float, automotive: float) -> dict[SensorGrade, float]:
    return {SensorGrade.IDEAL: ideal, SensorGrade.AUTOMOTIVE: automotive}


HEADLINES: tuple[Headline, ...] = (
    Headline(
        "known_worst_mape",
        "global regressor, worst scenario MAPE, known roads",
        "3 %",
        _targets(ideal=0.020, automotive=0.035),
    ),
    Headline("cv_median_mape", "8-fold CV, median MAPE", "1.68 %", _targets(ideal=0.016, automotive=0.030)),
    Headline("sfs15_mape", "15 selected features, MAPE", "~2.5 %", _targets(ideal=0.020, automotive=0.040)),
    Headline("relative_rms", "relative RMS, individual vehicles", "< 5 %", _targets(ideal=0.03, automotive=0.05)),
    Headline(
        "unseen_roads_mape",
        "unseen roads, MAPE, full coverage",
        target_frac=_targets(ideal=0.025, automotive=0.065),
    ),
    Headline(
        "unseen_roads_mape_80",
        "unseen roads, the 80 % of passages it is surest of",
        target_frac=_targets(ideal=0.020, automotive=0.045),
    ),
    Headline(
        "unseen_roads_mape_util60",
        "unseen roads, peak utilisation 0.6 and more",
        target_frac=_targets(ideal=0.015, automotive=0.030),
    ),
    Headline(
        "unseen_fleet_mape",
        "unseen roads, fleet of varied vehicles",
        target_frac=_targets(ideal=0.050, automotive=0.085),
    ),
    Headline(
        "interval50_worst_known",
        "interval error, 50 vehicles, worst over base frictions, known roads",
        "~10 %",
        _targets(ideal=0.06, automotive=0.08),
    ),
    Headline(
        "interval10_worst_known_best",
        "the same with 10 vehicles, best estimator",
        "barely tolerable",
        _targets(ideal=0.10, automotive=0.12),
    ),
    Headline(
        "interval50_worst_unseen",
        "interval error, 50 vehicles, unseen roads, best estimator",
        target_frac=_targets(ideal=0.06, automotive=0.10),
    ),
    Headline(
        "extreme_flagged_frac",
        "extreme manoeuvres flagged as outside the envelope",
        "order of magnitude worse",
        _targets(ideal=0.95, automotive=0.95),
        at_least=True,
    ),
    Headline(
        "normal_flagged_frac",
        "false flags on known roads",
        target_frac=_targets(ideal=0.02, automotive=0.02),
    ),
    Headline(
        "unseen_flagged_frac",
        "false flags on unseen roads",
        target_frac=_targets(ideal=0.05, automotive=0.05),
    ),
)
BESIDE = ("unseen_roads_p95_road", "unseen_ringebu_mape", "leave_one_out_worst_mape", "unseen_roads_coverage_80")
"""Named by the definitions of the headlines, without targets."""


def summary(findings: Sequence[Finding], *, seed: int, quick: bool, version: str) -> dict[str, Any]:
    """Return the object of `summary.json`: headlines by grade and configuration, and what they rest on.

    A headline that no chapter gave is null and listed; one that several gave is the first one's, and listed too.

    Args:
        findings: Of all chapters, of both parts.
        seed: Of the study.
        quick: Whether it was the rough one.
        version: Of the code as a whole.
    """
    document: dict[str, Any] = {}
    missing: list[str] = []
    contested: list[str] = []
    for grade in SensorGrade:
        given = _given(findings, grade)
        configs: dict[str, dict[str, float | None]] = {}
        for config in (*CONFIGS, *EXTRA_CONFIGS):
            figures = {name: found for (where, name), found in given.items() if where == config}
            wanted = (headline.name for headline in HEADLINES) if config in CONFIGS else ()
            names = dict.fromkeys((*wanted, *(BESIDE if config in CONFIGS else ()), *figures))
            configs[config] = {name: _finite(figures[name][0][1]) if name in figures else None for name in names}
            missing += [f"{grade.value}.{config}.{name}" for name, value in configs[config].items() if value is None]
            contested += [
                f"{grade.value}.{config}.{name}: {', '.join(chapter for chapter, _ in found)}"
                for name, found in figures.items()
                if len(found) > 1
            ]
        document[grade.value] = configs
    document["missing"] = missing
    document["contested"] = contested
    document["unknown"] = sorted(_unknown(findings))
    document["defects"] = [line for finding in findings for line in finding.defects]
    document["quick"] = quick
    document["seed"] = seed
    document["code_version"] = version
    document["wall_s"] = round(sum(done.timing.wall_s for finding in findings for done in finding.computed.values()))
    document["chapters"] = {
        finding.chapter.name: {
            grade.value: {
                "sizes": dict(done.result.sizes),
                "code_digest": done.code_digest,
                "data_digests": dict(done.data),
                "wall_s": round(done.timing.wall_s, 1),
                "cpu_s": round(done.timing.cpu_s, 1),
            }
            for grade, done in finding.computed.items()
        }
        for finding in findings
    }
    plain: dict[str, Any] = in_short(document)
    return plain


def _given(findings: Sequence[Finding], grade: SensorGrade) -> dict[tuple[str, str], list[tuple[str, float]]]:
    """Return what chapters gave: their names and figures, by configuration and name of the headline."""
    given: dict[tuple[str, str], list[tuple[str, float]]] = {}
    for finding in findings:
        if grade in finding.results:
            for key, value in finding.results[grade].figures.items():
                if key.startswith(PREFIX):
                    config, _, name = key.removeprefix(PREFIX).partition(".")
                    given.setdefault((config, name), []).append((finding.chapter.name, value))
    return given


def _unknown(findings: Sequence[Finding]) -> set[str]:
    """Return headlines of configurations that there are not: misspelt, most likely."""
    return {
        f"{config}.{name}"
        for grade in SensorGrade
        for config, name in _given(findings, grade)
        if config not in {*CONFIGS, *EXTRA_CONFIGS}
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
