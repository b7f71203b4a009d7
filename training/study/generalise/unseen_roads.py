"""Roads the model has never seen: random ones held out, the paper's own left out, and real ones from a map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from roadgrip.units import BoolArray, FloatArray
from training.accuracy import by_group, mape_ratio
from training.study.chapter import Cell, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import box_of, cloud_of, identity_line, per_cent
from training.study.folds import FOLDS_COUNT, LEARNED_SETS, PAPER_SET, TWO_FRICTIONS_SET
from training.study.generalise.held_out import (
    HIGH_UTILISATION_RATIO,
    SUREST_FRAC,
    HeldOut,
    band_name,
    band_of,
    by_use,
    held_out,
    left_out_roads,
    mean_by_road,
    on_other_roads,
    surest,
)
from training.study.picture import Axis, Bars, Boxes, Line, Lines, Picture, Scatter
from training.study.recipes import BEST_RECIPE, PAPER_RECIPE, SPEED_ONLY_RECIPE, Recipe
from training.study.wording import by_grade, leading_grade
from vehicle_client.simulator.plan import SensorGrade

RINGEBU_SET = "ringebu"
CONFIGS: Mapping[str, Recipe] = {
    "paper_config": PAPER_RECIPE,
    "best": BEST_RECIPE,
    "speed_only": SPEED_ONLY_RECIPE,
}
"""By the names of the study's headlines."""
P95_FRAC = 0.95
COVERAGES_FRAC = tuple(np.round(np.arange(0.1, 1.01, 0.05), 2).tolist())
TOLD_COVERAGES_FRAC = (0.5, 0.7, 0.8, 0.9, 1.0)
LENGTH_BANDS_M = ((0.0, 100.0), (100.0, 200.0), (200.0, 350.0), (350.0, np.inf))
RADIUS_BANDS_M = ((0.0, 35.0), (35.0, 70.0), (70.0, 140.0), (140.0, np.inf))
FEW_COUNT = 20
"""Fewer passages make no figure of their own."""
HARDLY_FRAC = 0.8
"""A fifth less error than from the speed alone is hardly better."""
USABLE_MAPE = 0.1
"""An error that a road authority might still live with for a single passage."""


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Judge every configuration on roads of which nothing was learned."""
    random, two_frictions, ringebu, left_out, moved = {}, {}, {}, {}, {}
    for config, recipe in CONFIGS.items():
        random[config] = held_out(bench, grade, recipe)
        two_frictions[config] = held_out(bench, grade, recipe, data_set=TWO_FRICTIONS_SET)
        ringebu[config] = on_other_roads(bench, grade, recipe, data_set=RINGEBU_SET)
        moved[config] = on_other_roads(bench, grade, recipe, data_set=PAPER_SET)
        left_out[config] = left_out_roads(bench, grade, recipe)
    figures: dict[str, float] = {}
    for config in CONFIGS:
        figures |= {f"headline.{config}.{name}": value for name, value in headline_figures(random[config]).items()}
        figures |= {f"{config}.{name}": value for name, value in more_figures(random[config]).items()}
        figures[f"{config}.two_frictions_mape"] = two_frictions[config].mape_ratio
        real = ringebu[config]
        if len(real):
            figures[f"headline.{config}.unseen_ringebu_mape"] = real.mape_ratio
            figures[f"{config}.ringebu_p95_road"] = p95_road(real)
        for name, judged in (("left_out", left_out[config]), ("from_random", moved[config])):
            figures |= {f"{config}.{name}.{key}": value for key, value in scenario_mape_ratio(judged).items()}
        worst = max(scenario_mape_ratio(left_out[config]).values())
        figures[f"headline.{config}.leave_one_out_worst_mape"] = worst
    some = next(iter(random.values()))
    rejected = sum(outcome.startswith("rejected_") for outcome in some.runs.outcome)
    return Result(
        figures=figures,
        sizes={
            "runs on random roads": len(some.runs),
            "random roads": len(set(some.roads)),
            "folds, by road": FOLDS_COUNT,
            "passages judged on random roads": len(some),
            "passages on random roads that the vehicles themselves rejected": rejected,
            "random roads of two frictions": len(set(next(iter(two_frictions.values())).roads)),
            "passages judged on roads of two frictions": len(next(iter(two_frictions.values()))),
            "passages judged on Ringebu roads": len(next(iter(ringebu.values()))),
            "Ringebu roads": len(set(next(iter(ringebu.values())).roads)),
            "passages judged on the paper's roads": len(next(iter(left_out.values()))),
            "seed": bench.seed,
        },
        tables=(
            _where_table(random, two_frictions, ringebu, left_out, moved),
            _coverage_table(random),
            *(_part_table(title, what, random) for title, what in _parts(some).items()),
        ),
        pictures=(*_pictures(random, grade),),
    )


def headline_figures(judged: HeldOut) -> dict[str, float]:
    """Return the study's figures on held-out roads: every passage that kept to the road, doubtful ones included."""
    kept = surest(judged.expected_error_ratio, kept_frac=SUREST_FRAC)
    used = judged.utilisation_ratio >= HIGH_UTILISATION_RATIO
    return {
        "unseen_roads_mape": judged.mape_ratio,
        "unseen_roads_p95_road": p95_road(judged),
        "unseen_roads_mape_80": float(judged.error_ratio[kept].mean()),
        "unseen_roads_coverage_80": float(kept.mean()),
        "unseen_roads_mape_util60": float(judged.error_ratio[used].mean()) if used.any() else np.nan,
    }


def more_figures(judged: HeldOut) -> dict[str, float]:
    """Return what stands behind the headlines, by name."""
    curve = selective_mape_ratio(judged, TOLD_COVERAGES_FRAC)
    bias = mean_by_road(judged.log_ratio, judged.roads)
    return {
        "median_error": float(np.median(judged.error_ratio)),
        "p95_error": float(np.quantile(judged.error_ratio, P95_FRAC)),
        "median_road": float(np.median(mean_by_road(judged.error_ratio, judged.roads))),
        # What all vehicles of a road err alike does not go away by asking more of them.
        "road_bias_rms": float(np.sqrt(np.mean(bias**2))),
        **{f"coverage.{100.0 * frac:.0f}": value for frac, value in zip(TOLD_COVERAGES_FRAC, curve, strict=True)},
        **{
            f"utilisation.{band}": float(judged.error_ratio[chosen].mean())
            for band, chosen in by_use(judged.utilisation_ratio).items()
            if chosen.any()
        },
    }


def p95_road(judged: HeldOut) -> float:
    """Return the 95th percentile over roads of the MAPE of a road."""
    return float(np.quantile(mean_by_road(judged.error_ratio, judged.roads), P95_FRAC))


def selective_mape_ratio(judged: HeldOut, coverages_frac: Sequence[float]) -> tuple[float, ...]:
    """Return the MAPE of the surest passages for each share of them that is kept."""
    ordered = judged.error_ratio[np.argsort(judged.expected_error_ratio, kind="stable")]
    running = np.cumsum(ordered) / np.arange(1, len(ordered) + 1)
    kept = [int(surest(judged.expected_error_ratio, kept_frac=frac).sum()) for frac in coverages_frac]
    return tuple(float(running[count - 1]) for count in kept)


def scenario_mape_ratio(judged: HeldOut) -> dict[str, float]:
    """Return the MAPE of every scenario, by name."""
    scenario = [judged.runs.scenario[row] for row in judged.rows.tolist()]
    return by_group(mape_ratio, scenario, truth_mu=judged.label_mu, estimate_mu=judged.mu)


def _parts(judged: HeldOut) -> dict[str, dict[str, BoolArray]]:
    """Return which passages make up each part, by what they are parted by and the part's name."""
    friction = np.rint(100.0 * judged.runs.labels["base_friction_mu"][judged.rows])
    bend_1pm = np.maximum(np.abs(judged.column("curvature_min_1pm")), np.abs(judged.column("curvature_max_1pm")))
    radius_m = 1.0 / np.maximum(bend_1pm, 1e-6)
    length_m = judged.column("section_length_m")

    def banded(values: FloatArray, bands: Sequence[tuple[float, float]], unit: str) -> dict[str, BoolArray]:
        return {band_name(band, unit=unit): band_of(values, band) for band in bands}

    return {
        "largest share of the grip used": by_use(judged.utilisation_ratio),
        "base friction": {f"{part / 100.0:.2f}": friction == part for part in sorted(set(friction.tolist()))},
        "length of the road": banded(length_m, LENGTH_BANDS_M, "m"),
        "tightest radius": banded(radius_m, RADIUS_BANDS_M, "m"),
    }


def _where_table(
    random: Mapping[str, HeldOut],
    two_frictions: Mapping[str, HeldOut],
    ringebu: Mapping[str, HeldOut],
    left_out: Mapping[str, HeldOut],
    moved: Mapping[str, HeldOut],
) -> Table:
    def line(what: str, learned: str, values: Sequence[float | None]) -> tuple[Cell, ...]:
        return (what, learned, *(None if value is None else per_cent(value) for value in values))

    others = "other random roads"
    rows = [
        line("random roads", others, [random[config].mape_ratio for config in CONFIGS]),
        line("random roads, 95 % of roads are better", others, [p95_road(random[config]) for config in CONFIGS]),
        line("random roads of two frictions", others, [two_frictions[config].mape_ratio for config in CONFIGS]),
        line(
            "Ringebu",
            "random roads",
            [ringebu[config].mape_ratio if len(ringebu[config]) else None for config in CONFIGS],
        ),
    ]
    for learned, judged in (("the paper's other roads", left_out), ("random roads", moved)):
        by_scenario = {config: scenario_mape_ratio(judged[config]) for config in CONFIGS}
        rows += [
            line(name, learned, [by_scenario[config][name] for config in CONFIGS])
            for name in next(iter(by_scenario.values()))
        ]
    return Table(
        "MAPE on roads of which nothing was learned, in %",
        ("judged on", "learned from", *(f"{CONFIGS[config].name} ({config})" for config in CONFIGS)),
        tuple(rows),
        note="Every passage that kept to the road and left a summary, however little grip it used. Roads of two "
        "frictions: two like turns, one slipperier than the other, whose friction is asked for. Ringebu: bends of a "
        "real mountain road; empty where its map is not at hand. Two scenarios of the paper share the S-turn and are "
        "left out together.",
    )


def _coverage_table(random: Mapping[str, HeldOut]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    curves = {config: selective_mape_ratio(judged, TOLD_COVERAGES_FRAC) for config, judged in random.items()}
    for place, frac in enumerate(TOLD_COVERAGES_FRAC):
        rows.append((per_cent(frac), *(per_cent(curve[place]) for curve in curves.values())))
    return Table(
        "MAPE of the passages with the least error to expect, in %",
        ("share kept, %", *random),
        tuple(rows),
        note="The error to expect comes from a second regressor, which knows neither the road nor the friction.",
    )


def _part_table(title: str, parts: Mapping[str, BoolArray], random: Mapping[str, HeldOut]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name, chosen in parts.items():
        count = int(chosen.sum())
        errors = (
            per_cent(judged.error_ratio[chosen].mean()) if count >= FEW_COUNT else None for judged in random.values()
        )
        rows.append((name, count, *errors))
    return Table(f"MAPE on held-out random roads by {title}, in %", (title, "passages", *random), tuple(rows))


def _pictures(random: Mapping[str, HeldOut], grade: SensorGrade) -> tuple[Picture, ...]:
    told = {config: judged for config, judged in random.items() if config in {"paper_config", "best"}} or dict(random)
    parts = _parts(next(iter(random.values())))
    some = {
        title: {name: chosen for name, chosen in parts[title].items() if chosen.sum() >= FEW_COUNT} for title in parts
    }

    def bars(title: str) -> Bars:
        groups = (
            (config, tuple(per_cent(judged.error_ratio[chosen].mean()) for chosen in some[title].values()))
            for config, judged in random.items()
        )
        return Bars(
            f"MAPE on roads never seen by {title}, {grade} sensors",
            title,
            Axis("MAPE in %", low=0.0),
            tuple(some[title]),
            tuple(groups),
        )

    highest = 1.05 * max(float(judged.label_mu.max()) for judged in told.values())
    return (
        Scatter(
            f"Estimate against truth on roads never seen, {grade} sensors",
            Axis("true friction", low=0.0, high=highest),
            Axis("estimate", low=0.0, high=highest),
            tuple(cloud_of(judged.label_mu, judged.mu, name=config, seed=1) for config, judged in told.items()),
            (identity_line(0.0, highest),),
        ),
        Lines(
            f"MAPE of the surest passages on roads never seen, {grade} sensors",
            Axis("share of the passages kept, %"),
            Axis("MAPE in %", low=0.0),
            tuple(
                Line(
                    config,
                    tuple(100.0 * frac for frac in COVERAGES_FRAC),
                    tuple(per_cent(value) for value in selective_mape_ratio(judged, COVERAGES_FRAC)),
                )
                for config, judged in random.items()
            ),
        ),
        *(bars(title) for title in some if some[title]),
        Boxes(
            f"MAPE of a road never seen, over roads, {grade} sensors",
            "configuration",
            Axis("MAPE of a road in %", low=0.0),
            tuple(
                box_of(100.0 * mean_by_road(judged.error_ratio, judged.roads), name=config, group="random roads")
                for config, judged in random.items()
            ),
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Say whether what was learned on some roads is of use on the next."""
    grade = leading_grade(results)
    figures = results[grade].figures
    paper, best, speed = (figures[f"headline.{config}.unseen_roads_mape"] for config in CONFIGS)
    beside_speed = "hardly better than" if paper > HARDLY_FRAC * speed else "better than"
    of_use = "may be of use" if paper <= USABLE_MAPE else "is of little use"
    gain = f"{paper / best:.1f} times less" if best < paper else "no less"
    ringebu = "The real bends near Ringebu were not at hand."
    if all("headline.best.unseen_ringebu_mape" in result.figures for result in results.values()):
        ringebu = (
            f"On real bends near Ringebu it errs by {by_grade(results, 'headline.best.unseen_ringebu_mape')}, the "
            f"paper's configuration by {by_grade(results, 'headline.paper_config.unseen_ringebu_mape')}."
        )
    text = (
        "The paper's tests know the road. Its configuration errs by up to "
        f"{by_grade(results, 'headline.paper_config.leave_one_out_worst_mape')} on a road of the paper when it has "
        "learned from the others, and by "
        f"{by_grade(results, 'headline.paper_config.unseen_roads_mape')} on random roads when it has learned from "
        f"other random ones: {beside_speed} from the speed alone "
        f"({by_grade(results, 'headline.speed_only.unseen_roads_mape')}). On the next road it {of_use}. The best "
        f"regressor errs by {by_grade(results, 'headline.best.unseen_roads_mape')}, {gain} with {grade} sensors; on "
        f"the worst road of twenty by {by_grade(results, 'headline.best.unseen_roads_p95_road')}. The 80 % of the "
        f"passages that it is surest of err by {by_grade(results, 'headline.best.unseen_roads_mape_80')}, those that "
        f"used 60 % of the grip and more by {by_grade(results, 'headline.best.unseen_roads_mape_util60')}. {ringebu} "
        "After the paper's other roads alone it errs by up to "
        f"{by_grade(results, 'headline.best.leave_one_out_worst_mape')} on the one left out. What all vehicles of a "
        f"road err alike, and more vehicles do not cure, is {by_grade(results, 'best.road_bias_rms')} (root mean "
        "square over roads)."
    )
    return Verdict(Claim.NOT_CLAIMED, text)


CHAPTER = Chapter(
    name="unseen_roads",
    title="Roads the model has never seen",
    paper_says="",
    compute=compute,
    verdict=verdict,
    needs=(*LEARNED_SETS, RINGEBU_SET, PAPER_SET),
)
