"""Tables and pictures of the closed loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from roadgrip.sections import read_section
from rsu_app.domain.interval import MEDIAN_TYRE_RATIO
from training.closed_loop import Course
from training.study.chapter import Cell, Table
from training.study.generalise.loop_cases import (
    BEST,
    COMPLIANCES_FRAC,
    FRICTIONS_MU,
    HELD,
    HELD_CUT,
    LIKELIHOODS,
    MEDIAN,
    PAPER,
    POLICY,
    REFINED_CUT,
    SLIPPERY,
    SPEED,
    USUAL,
    WRONG_RATIOS,
    Setting,
)
from training.study.generalise.loop_measures import (
    KNOWN_WITHIN_FRAC,
    Drift,
    Phase,
    PhaseMeasures,
    advised_mps,
    published_mu,
    right_speed_mps,
)
from training.study.generalise.loop_model import ANY_SPEED_SET, DATA_SETS, Taught
from training.study.picture import Axis, Line, Lines

Courses = Mapping[str, Mapping[str, Course]]
"""By road and name of the setting."""
Measured = Mapping[str, Mapping[str, Sequence[PhaseMeasures]]]
"""By road, name of the setting, and phase."""


Drifts = Mapping[Setting, Mapping[str, Sequence[Drift]]]
"""What a wrong advice did: by setting, road and phase."""


def taught_table(taught: Mapping[str, Taught]) -> Table:
    """Return what models make of drives that they were not taught."""
    rows: list[tuple[Cell, ...]] = []
    for name, one in taught.items():
        parts = [
            asdict(one)[measure] for measure in ("mape_ratio", "doubtful_frac", "outside_box_frac", "strange_frac")
        ]
        rows += [(name, data_set, *(100.0 * part[data_set] for part in parts)) for data_set in DATA_SETS]
    return Table(
        "What models make of drives at any speed, in per cent",
        ("model", "drives", "MAPE", "taken for a bound", "outside the box", "strange driving"),
        tuple(rows),
        f"All by models that had not seen the drive, nor its road if it is a random one. {ANY_SPEED_SET}: drivers wish "
        "any speed, slow or fast, whatever the friction.",
    )


def unit_table(by_road: Measured) -> Table:
    """Return how a road side unit does as it is, by road and by the share of drivers who obey."""
    rules = [Setting(BEST, rule, share) for rule in (HELD, HELD_CUT) for share in COMPLIANCES_FRAC]
    return Table(
        "A road side unit as it is",
        (
            "rule",
            "obey, %",
            "road",
            *(f"summaries that count at {mu:g}, %" for mu in FRICTIONS_MU),
            *(f"error at {mu:g}, %" for mu in FRICTIONS_MU),
            *(f"marked as a bound at {mu:g}, % of the time" for mu in FRICTIONS_MU),
            *(f"lag at {mu:g}, min" for mu in FRICTIONS_MU),
            *(f"advice over the right one at {mu:g}" for mu in FRICTIONS_MU),
        ),
        tuple(
            (
                setting.rule,
                100.0 * setting.compliance_frac,
                road,
                *(_known(100.0 * one.counted_frac, "none") for one in by_name[setting.name]),
                *(_known(100.0 * one.error_frac, "silent") for one in by_name[setting.name]),
                *(_known(100.0 * one.marked_frac, "silent") for one in by_name[setting.name]),
                *(_known(one.lag_s / 60.0, "never") for one in by_name[setting.name]),
                *(one.advised_ratio for one in by_name[setting.name]),
            )
            for road, by_name in by_road.items()
            for setting in rules
        ),
        "The median is published; advice is held while too few vehicles name a friction. Cut at changes is an option. "
        "What is marked as a bound claims nothing: its error is that of what the model takes for usual.",
    )


def settled_table(road: str, by_name: Mapping[str, Sequence[PhaseMeasures]]) -> Table:
    """Return what units publish and advise on a road once they had an hour."""
    return Table(
        f"What is published and advised once settled: {road}",
        (
            "model, rule, obedient",
            *(f"bias at {mu:g}, %" for mu in FRICTIONS_MU),
            *(f"marked as a bound at {mu:g}, % of the time" for mu in FRICTIONS_MU),
            *(f"lag at {mu:g}, min" for mu in FRICTIONS_MU),
            *(f"advice over the right one at {mu:g}" for mu in FRICTIONS_MU),
        ),
        tuple(
            (
                name,
                *(_known(100.0 * one.bias_frac, "silent") for one in measures),
                *(_known(100.0 * one.marked_frac, "silent") for one in measures),
                *(_known(one.lag_s / 60.0, "never") for one in measures),
                *(one.advised_ratio for one in measures),
            )
            for name, measures in by_name.items()
        ),
        f"Bias of the middle of the interval that advice rests on, more than an hour after friction changed. Lag until "
        f"it is right within {100.0 * KNOWN_WITHIN_FRAC:.0f} %. The right advice is that for the true friction, not "
        "rounded down. Cut at changes or not, one course of vehicles: a few per cent are chance.",
    )


def traffic_table(road: str, by_name: Mapping[str, Sequence[PhaseMeasures]]) -> Table:
    """Return what becomes of the vehicles on a road."""
    return Table(
        f"Who leaves the road and who counts: {road}",
        (
            "model, rule, obedient",
            "left the road when slippery, %",
            "before the unit knew, %",
            "after, %",
            *(f"summaries that count at {mu:g}, %" for mu in FRICTIONS_MU),
            *(f"estimates that name a friction at {mu:g}, %" for mu in FRICTIONS_MU),
            *(f"largest share of grip used at {mu:g}, median" for mu in FRICTIONS_MU),
        ),
        tuple(
            (
                name,
                100.0 * measures[SLIPPERY].left_road_frac,
                _known(100.0 * measures[SLIPPERY].left_road_before_frac, "nobody came"),
                _known(100.0 * measures[SLIPPERY].left_road_after_frac, "nobody came"),
                *(_known(100.0 * one.counted_frac, "none") for one in measures),
                *(_known(100.0 * one.named_frac, "none") for one in measures),
                *(one.utilisation_ratio for one in measures),
            )
            for name, measures in by_name.items()
        ),
    )


def drift_table(drifts: Drifts) -> Table:
    """Return what lies do to what units publish and advise."""
    return Table(
        "What an advice that is wrong on purpose does, in per cent",
        (
            "model, rule, obedient",
            "road",
            "speed told over meant",
            *(f"friction claimed at {mu:g}" for mu in FRICTIONS_MU),
            *(f"speed meant at {mu:g}" for mu in FRICTIONS_MU),
        ),
        tuple(
            (
                setting.right.name,
                road,
                setting.told_ratio,
                *(_known(100.0 * one.claimed_frac, "nothing claimed") for one in by_phase),
                *(_known(100.0 * one.advised_frac, "none") for one in by_phase),
            )
            for setting, by_road in drifts.items()
            for road, by_phase in by_road.items()
        ),
        "Against the same vehicles when they are told what the unit means, once settled. The lie confirms itself where "
        "lower speeds lead to lower friction or higher ones to higher. What is marked as a lower bound claims nothing. "
        "Drivers are told speeds above the limit, too.",
    )


def _known(value: float, otherwise: str) -> Cell:
    return value if np.isfinite(value) else otherwise


def pictures(went: Courses, when: Sequence[Phase]) -> tuple[Lines, ...]:
    """Return what is published and advised over time, on the first road."""
    road = next(iter(went))
    by_name = went[road]
    at_s = np.concatenate([phase.looks_s for phase in when])
    hours = tuple((at_s / 3600.0).tolist())
    truth = np.concatenate([np.full(len(p.looks_s), MEDIAN_TYRE_RATIO * p.base_friction_mu) for p in when])
    section = read_section(road)
    right = np.concatenate(
        [
            np.full(len(p.looks_s), right_speed_mps(section, base_friction_mu=p.base_friction_mu, policy=POLICY))
            for p in when
        ]
    )

    def driven(settings: Sequence[Setting]) -> list[Setting]:
        return [setting for setting in settings if setting.name in by_name]

    def published(title: str, settings: Sequence[Setting]) -> Lines:
        said = [(_label(s), tuple(published_mu(by_name[s.name], at_s).tolist())) for s in driven(settings)]
        return Lines(
            f"{title}: {road}",
            Axis("hours"),
            Axis("middle of the interval", low=0.0, high=0.7),
            (
                Line("truth", hours, tuple(truth.tolist()), dashed=True),
                *(Line(name, hours, values) for name, values in said),
            ),
        )

    def advised(title: str, settings: Sequence[Setting]) -> Lines:
        said = [(_label(s), tuple((3.6 * advised_mps(by_name[s.name], at_s)).tolist())) for s in driven(settings)]
        return Lines(
            f"{title}: {road}",
            Axis("hours"),
            Axis("advised speed, km/h", low=0.0),
            (
                Line("for the true friction", hours, tuple((3.6 * right).tolist()), dashed=True),
                *(Line(name, hours, values) for name, values in said),
            ),
        )

    obedient = [Setting(BEST, rule, 1.0) for rule in (MEDIAN, REFINED_CUT, LIKELIHOODS, HELD_CUT)]
    half = [Setting(BEST, rule, 0.5) for rule in (MEDIAN, HELD_CUT, REFINED_CUT, LIKELIHOODS)]
    models = [Setting(name, MEDIAN, 1.0) for name in (PAPER, BEST, USUAL, SPEED)]
    lied = [Setting(BEST, HELD, 1.0, ratio) for ratio in (WRONG_RATIOS[0], 1.0, WRONG_RATIOS[1])]
    advice = [Setting(BEST, rule, 1.0) for rule in (MEDIAN, HELD, LIKELIHOODS)]
    return (
        published("What is published when half of the drivers obey", half),
        published("What is published when all drivers obey", obedient),
        published("What is published by models when all drivers obey", models),
        published("What is published when the advice is wrong on purpose", lied),
        advised("What is advised when all drivers obey", advice),
        advised("What is advised when the advice is wrong on purpose", lied),
    )


def _label(setting: Setting) -> str:
    told = "" if setting.told_ratio == 1.0 else f", told {setting.told_ratio:g} of it"
    return f"{setting.teaching}, {setting.rule}, {100.0 * setting.compliance_frac:.0f} % obey{told}"
