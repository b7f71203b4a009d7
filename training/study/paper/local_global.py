"""One regressor for all roads, or one for each: accuracy on held-out runs, scatter, residuals their distribution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from roadgrip.units import FloatArray
from training.accuracy import mape_ratio, relative_rms_ratio, rms_mu
from training.study.chapter import Cell, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import (
    bell_shares,
    box_of,
    cloud_of,
    histogram_of,
    identity_line,
    per_cent,
    shape_of,
)
from training.study.feature_selection import selected_features
from training.study.folds import PAPER_SET, Split, paper_split
from training.study.known_roads import (
    global_estimates,
    known_relative_rms_ratio,
    known_worst_mape_ratio,
    local_estimates,
)
from training.study.picture import Axis, Bars, Boxes, Line, Picture, Scatter
from training.study.recipes import PAPER_RECIPE, SPEED_ONLY_RECIPE
from training.study.wording import by_grade, leading_grade, per_cent_words
from vehicle_client.simulator.plan import SensorGrade

SELECTED, ALL = "15", "78"
GLOBAL, LOCAL = "global", "local"
EVERYWHERE = "all scenarios"
PAPER_GLOBAL_WORST_MAPE, PAPER_LOCAL_WORST_MAPE = 0.03, 0.02
PAPER_RELATIVE_RMS = 0.05
MARGINAL_RATIO = 1.5
"""The paper's own worst errors, 3 and 2 %, differ by this factor and are called marginally different."""
FRICTION_BAND_MU = 0.05
RESIDUAL_EDGES = np.linspace(-30.0, 30.0, 31)
"""In per cent of the truth."""


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Return how local and global regressors do with one grade of sensors."""
    split = paper_split(bench, grade)
    recipes = {SELECTED: replace(PAPER_RECIPE, features=selected_features(bench, grade)), ALL: PAPER_RECIPE}
    estimates = {
        (features, scope): estimate(bench, grade, recipe)
        for features, recipe in recipes.items()
        for scope, estimate in ((GLOBAL, global_estimates), (LOCAL, local_estimates))
    }
    speed_mu = global_estimates(bench, grade, SPEED_ONLY_RECIPE)
    truth_mu = split.label_mu(split.test_rows)
    parts = scenario_masks(split)
    figures = {
        f"{figure}.{features}.{scope}.{part}": of(truth_mu[mask], estimate[mask])
        for (features, scope), estimate in estimates.items()
        for part, mask in parts.items()
        for figure, of in (("mape", mape_ratio), ("relative_rms", relative_rms_ratio), ("rms_mu", rms_mu))
    }
    figures |= {f"mape.speed.{part}": mape_ratio(truth_mu[mask], speed_mu[mask]) for part, mask in parts.items()}
    for features in recipes:
        for scope in (GLOBAL, LOCAL):
            figures[f"worst_mape.{features}.{scope}"] = max(
                figures[f"mape.{features}.{scope}.{part}"] for part in split.scenarios
            )
        figures |= _residual_figures(truth_mu, estimates[features, GLOBAL], features)
    for config, recipe in (("paper_config", PAPER_RECIPE), ("speed_only", SPEED_ONLY_RECIPE)):
        figures[f"headline.{config}.known_worst_mape"] = known_worst_mape_ratio(bench, grade, recipe)
        figures[f"headline.{config}.relative_rms"] = known_relative_rms_ratio(bench, grade, recipe)
    return Result(
        figures=figures,
        sizes={
            "rows learned from": len(split.train_rows),
            "rows judged": len(split.test_rows),
            "trees": 100,
            "seed": bench.seed,
            **{f"rows judged, {part}": int(parts[part].sum()) for part in split.scenarios},
        },
        tables=(
            _accuracy_table(figures, split),
            _shape_table(figures),
            _band_table(truth_mu, estimates[SELECTED, GLOBAL], estimates[SELECTED, LOCAL]),
        ),
        pictures=_pictures(truth_mu, estimates, parts, split.scenarios, grade=grade, seed=bench.seed),
    )


def scenario_masks(split: Split) -> dict[str, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """Return which of the held-out rows belong to each scenario, and to all of them."""
    where = np.array(split.runs.scenario)[split.test_rows]
    return {**{name: where == name for name in split.scenarios}, EVERYWHERE: np.ones(len(where), dtype=bool)}


def band_residuals(truth_mu: FloatArray, estimate_mu: FloatArray) -> list[tuple[float, float, float, int]]:
    """Return mean and deviation of the relative residuals in bands of true friction, with few runs left out.

    Returns:
        Lower end of the band, mean residual, standard deviation, both relative to the truth, and how many runs, for
        bands of at least ten.
    """
    residual = (estimate_mu - truth_mu) / truth_mu
    band = np.floor(truth_mu / FRICTION_BAND_MU + 1e-9).astype(int)
    rows = ((number, residual[band == number]) for number in np.unique(band))
    return [
        (float(number * FRICTION_BAND_MU), float(values.mean()), float(values.std()), len(values))
        for number, values in rows
        if len(values) >= 10
    ]


def _residual_figures(truth_mu: FloatArray, estimate_mu: FloatArray, features: str) -> dict[str, float]:
    residual = (estimate_mu - truth_mu) / truth_mu
    shape, bands = shape_of(residual), band_residuals(truth_mu, estimate_mu)
    return {
        f"residual_mean.{features}": shape.mean_value,
        f"residual_std.{features}": shape.std_value,
        f"residual_skewness.{features}": shape.skewness_ratio,
        f"residual_kurtosis.{features}": shape.kurtosis_ratio,
        f"residual_within_one_std.{features}": shape.within_one_std_frac,
        f"residual_within_two_std.{features}": shape.within_two_std_frac,
        f"residual_worst_band_mean.{features}": max((abs(mean) for _, mean, _, _ in bands), default=0.0),
        f"residual_truth_correlation.{features}": float(np.corrcoef(truth_mu, estimate_mu - truth_mu)[0, 1]),
    }


def _accuracy_table(figures: Mapping[str, float], split: Split) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for part in (*split.scenarios, EVERYWHERE):
        cells: list[Cell] = [part]
        for figure in ("mape", "relative_rms"):
            cells += [
                per_cent(figures[f"{figure}.{features}.{scope}.{part}"])
                for features in (SELECTED, ALL)
                for scope in (GLOBAL, LOCAL)
            ]
        cells.append(per_cent(figures[f"mape.speed.{part}"]))
        rows.append(tuple(cells))
    columns = [
        f"{figure} %, {features} features, {scope}"
        for figure in ("MAPE", "relative RMS")
        for features in (SELECTED, ALL)
        for scope in (GLOBAL, LOCAL)
    ]
    return Table(
        "Local and global regressors on held-out runs",
        ("scenario", *columns, "MAPE %, speed only, global"),
        tuple(rows),
        note="Global: one regressor taught on all scenarios. Local: one for each, taught on its runs alone. The RMS of "
        "the errors is in per cent of the truth, each error by its own truth.",
    )


def _shape_table(figures: Mapping[str, float]) -> Table:
    names = (
        ("mean, % of the truth", "residual_mean", 100.0, 0.0),
        ("standard deviation, % of the truth", "residual_std", 100.0, None),
        ("skewness", "residual_skewness", 1.0, 0.0),
        ("excess kurtosis", "residual_kurtosis", 1.0, 0.0),
        ("within one standard deviation, %", "residual_within_one_std", 100.0, 68.3),
        ("within two, %", "residual_within_two_std", 100.0, 95.4),
        ("largest mean in a band of friction, %", "residual_worst_band_mean", 100.0, 0.0),
        ("correlation of residual and truth", "residual_truth_correlation", 1.0, 0.0),
    )
    return Table(
        "The residuals of the global regressor",
        ("figure", "15 features", "78 features", "if normal and without pattern"),
        tuple(
            (text, *(scale * figures[f"{key}.{f}"] for f in (SELECTED, ALL)), usual)
            for text, key, scale, usual in names
        ),
        note="Estimate minus truth, relative to the truth but for the correlation.",
    )


def _band_table(truth_mu: FloatArray, global_mu: FloatArray, local_mu: FloatArray) -> Table:
    local = {low: (mean, std) for low, mean, std, _ in band_residuals(truth_mu, local_mu)}
    return Table(
        "Residuals by band of true friction, 15 features",
        ("friction from", "runs", "global: mean %", "global: deviation %", "local: mean %", "local: deviation %"),
        tuple(
            (low, count, per_cent(mean), per_cent(std), per_cent(local[low][0]), per_cent(local[low][1]))
            for low, mean, std, count in band_residuals(truth_mu, global_mu)
        ),
        note=f"Bands {FRICTION_BAND_MU:g} wide.",
    )


def _pictures(
    truth_mu: FloatArray,
    estimates: Mapping[tuple[str, str], FloatArray],
    parts: Mapping[str, np.ndarray[tuple[int], np.dtype[np.bool_]]],
    scenarios: tuple[str, ...],
    *,
    grade: SensorGrade,
    seed: int,
) -> tuple[Picture, ...]:
    residual = {key: 100.0 * (estimate - truth_mu) / truth_mu for key, estimate in estimates.items()}
    boxes = Boxes(
        f"Absolute error by scenario, {grade} sensors",
        "scenario",
        Axis("absolute error in % of the truth", low=0.0),
        tuple(
            box_of(np.abs(residual[features, scope][parts[part]]), name=part, group=f"{scope}, {features} features")
            for part in (*scenarios, EVERYWHERE)
            for features in (SELECTED, ALL)
            for scope in (GLOBAL, LOCAL)
        ),
    )
    low, high = float(truth_mu.min()), float(truth_mu.max())
    scatters = tuple(
        Scatter(
            f"Estimate against truth, {part}, 15 features, {grade} sensors",
            Axis("true friction"),
            Axis("estimated friction"),
            tuple(
                cloud_of(truth_mu[parts[part]], estimates[SELECTED, scope][parts[part]], name=scope, seed=seed)
                for scope in (GLOBAL, LOCAL)
            ),
            (identity_line(low, high),),
        )
        for part in scenarios
    )
    residuals = tuple(
        Scatter(
            f"Residuals of the {scope} regressor{'' if scope == GLOBAL else 's'}, 15 features, {grade} sensors",
            Axis("true friction"),
            Axis("estimate minus truth, friction"),
            tuple(
                cloud_of(
                    truth_mu[parts[part]],
                    (estimates[SELECTED, scope] - truth_mu)[parts[part]],
                    name=part,
                    seed=seed,
                )
                for part in scenarios
            ),
            (Line("no error", (low, high), (0.0, 0.0), dashed=True),),
        )
        for scope in (GLOBAL, LOCAL)
    )
    return (
        boxes,
        *scatters,
        *residuals,
        _distribution({scope: residual[SELECTED, scope] for scope in (GLOBAL, LOCAL)}, grade=grade),
    )


def _distribution(residual: Mapping[str, FloatArray], *, grade: SensorGrade) -> Bars:
    """Return how residuals are distributed beside a bell as wide as the global regressor's.

    Args:
        residual: In per cent of the truth, by scope. Each (n,)
        grade: Of the sensors.
    """
    shape = shape_of(residual[GLOBAL])
    centres = 0.5 * (RESIDUAL_EDGES[:-1] + RESIDUAL_EDGES[1:])
    return Bars(
        f"Distribution of the residuals, 15 features, {grade} sensors",
        "estimate minus truth in % of the truth; the outer bins hold all beyond",
        Axis("share of runs in %", low=0.0),
        tuple(f"{centre:g}" for centre in centres),
        (
            *histogram_of(dict(residual), edge_values=RESIDUAL_EDGES),
            (
                "normal, as wide as global",
                bell_shares(mean_value=shape.mean_value, std_value=shape.std_value, edge_values=RESIDUAL_EDGES),
            ),
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Return what to make of it: is one regressor for all roads nearly as good, and are both as good as the paper's."""
    grade = leading_grade(results)
    figures = results[grade].figures
    worst = {scope: figures[f"worst_mape.{SELECTED}.{scope}"] for scope in (GLOBAL, LOCAL)}
    marginal = all(
        figures[f"worst_mape.{features}.{GLOBAL}"] <= MARGINAL_RATIO * figures[f"worst_mape.{features}.{LOCAL}"]
        for features in (SELECTED, ALL)
    )
    as_good = worst[GLOBAL] <= PAPER_GLOBAL_WORST_MAPE and worst[LOCAL] <= PAPER_LOCAL_WORST_MAPE
    rms = figures[f"relative_rms.{SELECTED}.{GLOBAL}.{EVERYWHERE}"]
    small_rms = rms <= PAPER_RELATIVE_RMS
    symmetrical = abs(figures[f"residual_skewness.{SELECTED}"]) <= 0.5
    bell = abs(figures[f"residual_kurtosis.{SELECTED}"]) <= 1.0
    band = figures[f"residual_worst_band_mean.{SELECTED}"]
    patternless = band <= 0.5 * figures[f"residual_std.{SELECTED}"]
    kept = (marginal, as_good, small_rms, symmetrical and bell and patternless)
    claim = Claim.CONFIRMED if all(kept) else Claim.PARTLY if any(kept) else Claim.NOT_CONFIRMED
    text = (
        f"With {grade} sensors and 15 features the global regressor's worst scenario ({_worst_scenario(figures)}) has "
        f"a MAPE of {per_cent_words(worst[GLOBAL])}, the local ones' {per_cent_words(worst[LOCAL])} (the paper: 3 and "
        f"2 %); with all 78, {per_cent_words(figures[f'worst_mape.{ALL}.{GLOBAL}'])} and "
        f"{per_cent_words(figures[f'worst_mape.{ALL}.{LOCAL}'])}. So a single regressor for all known roads costs "
        f"{'only a margin' if marginal else 'more than a margin'}, and the errors are "
        f"{'as small as' if as_good else 'larger than'} the paper's. Worst scenario, 78 features: "
        f"{by_grade(results, 'headline.paper_config.known_worst_mape')}; from the speed alone: "
        f"{by_grade(results, 'headline.speed_only.known_worst_mape')}. The relative RMS is {per_cent_words(rms)} with "
        f"15 features and, with 78, {by_grade(results, 'headline.paper_config.relative_rms')}, where the paper has at "
        f"most 5 %. The residuals are {'symmetrical' if symmetrical else 'lopsided'} (skewness "
        f"{figures[f'residual_skewness.{SELECTED}']:.2f}), "
        f"{'nearly normal' if bell else 'heavier in the tails than a normal distribution'} (excess kurtosis "
        f"{figures[f'residual_kurtosis.{SELECTED}']:.1f}), and "
        f"{'without a clear pattern' if patternless else 'not without a pattern'} over friction: the largest mean in a "
        f"band is {per_cent_words(band)}. All this on roads that were learned; it says nothing of the next road."
    )
    return Verdict(claim, text)


def _worst_scenario(figures: Mapping[str, float]) -> str:
    """Return where the global regressor with 15 features is worst."""
    start = f"mape.{SELECTED}.{GLOBAL}."
    return max((key for key in figures if key.startswith(start)), key=lambda key: figures[key]).removeprefix(start)


CHAPTER = Chapter(
    name="local_global",
    title="Local against global regressors",
    paper_says=(
        "A regressor for each road is only slightly better than one for all: the worst scenario's MAPE is 2 % for the "
        "local ones and 3 % for the global one, with 15 features, and the RMS stays below 5 % of the truth. Residuals "
        "scatter around zero without a pattern, almost normally and symmetrically."
    ),
    compute=compute,
    verdict=verdict,
    needs=(PAPER_SET,),
)
