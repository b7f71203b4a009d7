"""The advisory changes how people drive: does a unit still find the friction, and do lies come true?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from roadgrip.sections import read_section
from training.closed_loop import SLOT_S, Case, Course, closed_loop
from training.study.chapter import Arrays, Chapter, Result, Workbench
from training.study.folds import side_by_side
from training.study.generalise.loop_cases import (
    FRICTIONS_MU,
    PHASE_NAMES,
    POLICY,
    QUICK_SETTINGS,
    RULES,
    SETTINGS,
    TEACHINGS,
    Setting,
)
from training.study.generalise.loop_measures import (
    Phase,
    drift,
    farthest,
    largest,
    phase_measures,
    phases,
)
from training.study.generalise.loop_model import DATA_SETS, Taught, Teaching, loop_models, what_is_taught
from training.study.generalise.loop_tables import (
    Courses,
    Drifts,
    Measured,
    drift_table,
    pictures,
    settled_table,
    taught_table,
    traffic_table,
    unit_table,
)
from training.study.generalise.loop_vehicles import schooled_cars, simulated, terms_of, travellers
from training.study.generalise.loop_verdict import verdict
from vehicle_client.estimation.grip.memory import CarMemory
from vehicle_client.simulator.plan import SensorGrade

ROADS = ("long-turn", "s-turn")
"""On the paper's third road, the sharp turn at 20 km/h, there is nothing to advise."""
QUICK_ROADS = ROADS[:1]
PHASE_S = 7200.0
QUICK_PHASE_S = 4500.0
VEHICLES_PER_HOUR = 60.0
QUICK_VEHICLES_PER_HOUR = 30.0


def courses(bench: Workbench, grade: SensorGrade) -> Courses:
    """Return how every setting goes on every road."""
    roads = QUICK_ROADS if bench.quick else ROADS

    def work() -> Arrays:
        models = loop_models(bench, grade, _taught(bench))
        cases = [
            Case(s.name, models[s.teaching], RULES[s.rule], s.compliance_frac, s.told_ratio) for s in _settings(bench)
        ]
        # Before the roads: the workbench remembers for one thread at a time.
        memories = schooled_cars(bench, grade)
        found: dict[str, dict[str, Course]] = {}

        def drive(road: str) -> None:
            found[road] = _courses_on(road, cases, bench, grade, memories)

        bench.report(f"roads of the closed loop, {grade}", 0, len(roads))
        side_by_side(
            [partial(drive, road) for road in roads],
            on_done=lambda done: bench.report(f"roads of the closed loop, {grade}", done, len(roads)),
        )
        return {
            f"{road}/{name}/{column}": values
            for road, by_name in found.items()
            for name, course in by_name.items()
            for column, values in course.arrays().items()
        }

    kept = bench.remembered(f"closed-loop-{grade}-{bench.seed}", work)
    by_course: dict[tuple[str, str], dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]]] = {}
    for key, values in kept.items():
        road, name, column = key.split("/")
        by_course.setdefault((road, name), {})[column] = values
    return {
        road: {name: Course.of_arrays(columns) for (of, name), columns in by_course.items() if of == road}
        for road in roads
    }


def _courses_on(
    road: str, cases: Sequence[Case], bench: Workbench, grade: SensorGrade, memories: Mapping[int, CarMemory]
) -> dict[str, Course]:
    """Return how every case goes on a road, by name."""
    section, terms = read_section(road), terms_of(bench.seed, grade)
    coming = travellers(
        section,
        phases_mu=FRICTIONS_MU,
        phase_s=_phase_s(bench),
        vehicles_per_hour=QUICK_VEHICLES_PER_HOUR if bench.quick else VEHICLES_PER_HOUR,
        terms=terms,
        sensor_seeds=tuple(memories),
    )
    return closed_loop(cases, coming, section=section, drive=simulated(section, terms, memories=memories))


def _phase_s(bench: Workbench) -> float:
    return QUICK_PHASE_S if bench.quick else PHASE_S


def _settings(bench: Workbench) -> tuple[Setting, ...]:
    return QUICK_SETTINGS if bench.quick else SETTINGS


def _taught(bench: Workbench) -> list[Teaching]:
    wanted = {setting.teaching for setting in _settings(bench)}
    return [teaching for teaching in TEACHINGS if teaching.name in wanted]


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Let vehicles drive by what units say, and units judge what those vehicles find."""
    went = courses(bench, grade)
    taught = {one.name: what_is_taught(bench, grade, one) for one in _taught(bench) if not one.in_a_box}
    when = phases(FRICTIONS_MU, phase_s=_phase_s(bench))
    measured = {
        road: {
            name: [phase_measures(course, phase, section=read_section(road), policy=POLICY) for phase in when]
            for name, course in by_name.items()
        }
        for road, by_name in went.items()
    }
    settings = _settings(bench)
    drifts = _drifts(went, when, settings)
    vehicles_count = sum(len(by_name[settings[0].name].at_s) for by_name in went.values())
    return Result(
        figures=_figures(measured, drifts, taught, settings),
        sizes={
            "roads": len(went),
            "vehicles_by_setting": vehicles_count,
            "settings": len(settings),
            "slot_s": round(SLOT_S),
            "phase_s": round(_phase_s(bench)),
            "seed": bench.seed,
        },
        tables=(
            unit_table(measured),
            taught_table(taught),
            *(settled_table(road, by_name) for road, by_name in measured.items()),
            *(traffic_table(road, by_name) for road, by_name in measured.items()),
            drift_table(drifts),
        ),
        pictures=pictures(went, when),
    )


def _drifts(went: Courses, when: Sequence[Phase], settings: Sequence[Setting]) -> Drifts:
    return {
        setting: {
            road: [drift(by_name[setting.name], by_name[setting.right.name], phase) for phase in when]
            for road, by_name in went.items()
        }
        for setting in settings
        if setting.told_ratio != 1.0
    }


def _figures(
    measured: Measured, drifts: Drifts, taught: Mapping[str, Taught], settings: Sequence[Setting]
) -> dict[str, float]:
    figures: dict[str, float] = {}
    for setting in settings:
        for place, phase in enumerate(PHASE_NAMES):
            here = [by_name[setting.name][place] for by_name in measured.values()]
            key = f"{setting.name}.{phase}"
            figures[f"{key}.worst_bias"] = farthest([one.bias_frac for one in here])
            figures[f"{key}.worst_claimed_bias"] = farthest([one.claimed_bias_frac for one in here])
            figures[f"{key}.most_marked"] = largest([one.marked_frac for one in here])
            figures[f"{key}.worst_lag_s"] = max(one.lag_s for one in here)
            figures[f"{key}.worst_left_road"] = max(one.left_road_frac for one in here)
            figures[f"{key}.least_counted"] = min(one.counted_frac for one in here)
            figures[f"{key}.fastest_advice"] = max(one.advised_ratio for one in here)
            figures[f"{key}.slowest_advice"] = min(one.advised_ratio for one in here)
    for setting, by_road in drifts.items():
        for place, phase in enumerate(PHASE_NAMES):
            here_drifts, way = [by_phase[place] for by_phase in by_road.values()], np.sign(setting.told_ratio - 1.0)
            key = f"{setting.name}.{phase}"
            figures[f"{key}.claimed_towards_lie"] = largest([way * one.claimed_frac for one in here_drifts])
            figures[f"{key}.advised_towards_lie"] = largest([way * one.advised_frac for one in here_drifts])
    for name, one in taught.items():
        for data_set in DATA_SETS:
            figures[f"{name}.{data_set}.mape"] = one.mape_ratio[data_set]
            figures[f"{name}.{data_set}.doubtful"] = one.doubtful_frac[data_set]
            figures[f"{name}.{data_set}.outside_box"] = one.outside_box_frac[data_set]
            figures[f"{name}.{data_set}.strange"] = one.strange_frac[data_set]
    return figures


CHAPTER = Chapter(
    name="closed_loop",
    title="Closed loop: the advisory changes how people drive",
    paper_says="",
    compute=compute,
    verdict=verdict,
    needs=DATA_SETS,
)
