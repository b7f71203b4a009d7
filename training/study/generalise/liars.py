"""How far can three vehicles in ten, lying or broken, shift the interval? For each rule, by several strategies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from roadgrip.units import FloatArray
from rsu_app.domain.interval import MEDIAN_TYRE_RATIO, WORN_TYRE_RATIO
from training.study.chapter import Arrays, Cell, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.generalise.passages import Passages, Traffic, drawn_passages
from training.study.generalise.rules import LOOSE, MEDIAN, POLICY, POSTERIOR, REFINED, RULES, interval_of
from training.study.picture import Axis, Line, Lines
from vehicle_client.simulator.plan import SensorGrade

MU_NEW = 0.5
VEHICLES_COUNT = 50
LIARS_FRAC = 0.3
WINDOWS_COUNT = 400
QUICK_WINDOWS_COUNT = 40
SWEEP_RATIO = np.geomspace(0.5, 2.0, 41)
"""What liars say together, over what a new tyre finds."""
SHARES_FRAC = (0.05, 0.1, 0.2, 0.3, 0.4)
SUREST_RATIO = 0.0
"""Liars pass for as exact as a rule believes."""

Lie = Callable[[np.random.Generator, int], FloatArray]
"""What so many liars say, over what a new tyre finds."""


@dataclass(frozen=True, slots=True)
class Strategy:
    """One way to lie or to be broken.

    Attributes:
        name: For people.
        lie: What liars say.
        at_least: Whether they only say "at least".
    """

    name: str
    lie: Lie
    at_least: bool = False


def all_say(ratio: float) -> Lie:
    """Return the lie of liars who agree on a value."""
    return say_between(ratio, ratio)


def say_between(low_ratio: float, high_ratio: float) -> Lie:
    """Return the lie of those who say anything between two values."""
    return lambda rng, count: rng.uniform(low_ratio, high_ratio, count)


STRATEGIES: tuple[Strategy, ...] = (
    Strategy("all absurdly low", all_say(0.1)),
    Strategy("all absurdly high", all_say(3.0)),
    Strategy("all low, a worn tyre's friction less a tenth", all_say(0.9 * WORN_TYRE_RATIO)),
    Strategy("all high, a new tyre's friction and a tenth", all_say(1.1)),
    Strategy("just inside the interval, at its lower end", all_say(WORN_TYRE_RATIO)),
    Strategy("just inside the interval, at its upper end", all_say(1.0)),
    Strategy("at the clip's lower edge", all_say(MEDIAN_TYRE_RATIO * (1.0 - POLICY.clip_frac))),
    Strategy("at the clip's upper edge", all_say(MEDIAN_TYRE_RATIO * (1.0 + POLICY.clip_frac))),
    Strategy("anything, by a broken sensor", say_between(0.1, 2.4)),
    Strategy("as if the road were a fifth slipperier", say_between(0.8 * WORN_TYRE_RATIO, 0.8)),
    Strategy("as if the road had a fifth more grip", say_between(1.2 * WORN_TYRE_RATIO, 1.2)),
    Strategy('"at least" far too much', all_say(2.0), at_least=True),
)
COMPARED = tuple(RULES)


def with_liars(honest: Passages, strategy: Strategy, rng: np.random.Generator, *, liars_frac: float) -> Passages:
    """Return a window in which the first vehicles lie; they pass for surer than anybody.

    Args:
        honest: The window without lies.
        strategy: What they say.
        rng: Source of chance.
        liars_frac: Share of the vehicles that lie, rounded down.
    """
    count = int(liars_frac * len(honest) + 1e-9)
    mu, error = honest.mu.copy(), honest.expected_error_ratio.copy()
    at_least = honest.at_least.copy()
    mu[:count], error[:count] = MU_NEW * strategy.lie(rng, count), SUREST_RATIO
    at_least[:count] = strategy.at_least
    return Passages(mu, error, at_least)


@dataclass(frozen=True, slots=True)
class Window:
    """What vehicles say before any of them lies.

    Attributes:
        number: Of the window; what liars say follows from it.
        honest: What all say.
        answers_mu: What each rule makes of that.
    """

    number: int
    honest: Passages
    answers_mu: Mapping[str, float]


def honest_windows(windows_count: int, *, seed: int) -> tuple[Window, ...]:
    """Return windows without a lie, drawn by chance; the same ones for every strategy and rule."""
    windows = []
    for number in range(windows_count):
        rng = np.random.default_rng([seed, number])
        honest = drawn_passages(rng, VEHICLES_COUNT, mu_new=MU_NEW, traffic=Traffic())
        windows.append(Window(number, honest, {name: RULES[name](honest) for name in COMPARED}))
    return tuple(windows)


def mean_shift_ratio(
    strategy: Strategy, windows: Sequence[Window], *, liars_frac: float, seed: int
) -> dict[str, float]:
    """Return by how much liars shift each rule's answer in the mean over windows, relative; signed.

    Args:
        strategy: What they say.
        windows: In which they say it.
        liars_frac: Their share.
        seed: Of what they say.
    """
    shifts: dict[str, list[float]] = {name: [] for name in COMPARED}
    for window in windows:
        lied = with_liars(window.honest, strategy, _chance_of_liars(window, seed), liars_frac=liars_frac)
        for name in COMPARED:
            shifts[name].append(RULES[name](lied) / window.answers_mu[name] - 1.0)
    return {name: float(np.mean(values)) for name, values in shifts.items()}


def _chance_of_liars(window: Window, seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, window.number, 1])


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Answer for vehicles of known errors; the sensors play no part, so all grades share what is computed."""
    del grade
    windows_count = QUICK_WINDOWS_COUNT if bench.quick else WINDOWS_COUNT

    def work() -> Arrays:
        return _shifts(bench, honest_windows(windows_count, seed=bench.seed))

    found = bench.remembered(f"liars-{bench.seed}", work)
    by_strategy = {strategy.name: line for strategy, line in zip(STRATEGIES, _lines(found["strategy"]), strict=True)}
    sweep = _lines(found["sweep"])
    worst = {name: max(abs(shift[name]) for shift in (*by_strategy.values(), *sweep)) for name in COMPARED}
    return Result(
        figures={
            **{f"worst_shift.{name}": value for name, value in worst.items()},
            "half_width_holds_frac": float(found["half_width_holds_frac"]),
        },
        sizes={"windows": windows_count, "vehicles": VEHICLES_COUNT, "seed": bench.seed},
        tables=(
            _strategy_table(by_strategy, worst),
            _share_table(dict(zip(SHARES_FRAC, _lines(found["share"]), strict=True))),
        ),
        pictures=(_sweep_picture(sweep),),
    )


def _shifts(bench: Workbench, windows: Sequence[Window]) -> Arrays:
    """Return what all liars gain: by strategy, by value and by share one line each, rules as in `COMPARED`."""
    few = windows[: len(windows) // 4]
    by_strategy = []
    for done, strategy in enumerate(STRATEGIES):
        bench.report("strategies of liars", done, len(STRATEGIES))
        by_strategy.append(mean_shift_ratio(strategy, windows, liars_frac=LIARS_FRAC, seed=bench.seed))
    by_share = []
    for done, share in enumerate(SHARES_FRAC):
        bench.report("shares of liars", done, len(SHARES_FRAC))
        shifts = _sweep(SWEEP_RATIO[::2], few, liars_frac=share, seed=bench.seed)
        by_share.append({name: max(abs(shift[name]) for shift in shifts) for name in COMPARED})
    return {
        "strategy": _table_of(by_strategy),
        "sweep": _table_of(_sweep(SWEEP_RATIO, few, liars_frac=LIARS_FRAC, seed=bench.seed)),
        "share": _table_of(by_share),
        "half_width_holds_frac": np.array(_held_frac(windows, bench.seed)),
    }


def _table_of(lines: Sequence[Mapping[str, float]]) -> FloatArray:
    return np.array([[line[name] for name in COMPARED] for line in lines])


def _lines(table: FloatArray) -> list[dict[str, float]]:
    return [dict(zip(COMPARED, line, strict=True)) for line in table.tolist()]


def _sweep(ratios: FloatArray, windows: Sequence[Window], *, liars_frac: float, seed: int) -> list[dict[str, float]]:
    """Return the shift of each rule by liars who agree on a value, for every value."""
    return [
        mean_shift_ratio(Strategy("", all_say(ratio)), windows, liars_frac=liars_frac, seed=seed)
        for ratio in ratios.tolist()
    ]


def _held_frac(windows: Sequence[Window], seed: int) -> float:
    """Return the share of windows with liars whose half-width, told of three liars in ten, still holds the truth."""
    policy = replace(POLICY, liars_frac=LIARS_FRAC)
    held = []
    for window in windows:
        strategy = STRATEGIES[window.number % len(STRATEGIES)]
        lied = with_liars(window.honest, strategy, _chance_of_liars(window, seed), liars_frac=LIARS_FRAC)
        placed = interval_of(lied, policy=policy)
        held.append(abs(placed.mu_new - MU_NEW) <= placed.half_width_mu)
    return float(np.mean(held))


def _strategy_table(by_strategy: Mapping[str, Mapping[str, float]], worst: Mapping[str, float]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (name, *(100.0 * shift[rule] for rule in COMPARED)) for name, shift in by_strategy.items()
    ]
    rows.append(("worst, with every value tried", *(100.0 * worst[rule] for rule in COMPARED)))
    return Table(
        title="Mean shift of the interval by three liars in ten, in per cent",
        columns=("what they say", *COMPARED),
        rows=tuple(rows),
        note=f"{VEHICLES_COUNT} vehicles, noise 2 to 8 %, 3 % outliers; liars pass for the surest.",
    )


def _share_table(by_share: Mapping[float, Mapping[str, float]]) -> Table:
    return Table(
        title="Worst mean shift by the share of liars, in per cent",
        columns=("liars, per cent", *COMPARED),
        rows=tuple(
            (round(100.0 * share), *(100.0 * shift[rule] for rule in COMPARED)) for share, shift in by_share.items()
        ),
        note="Liars agree on one value; the worst of 21 between half and twice what a new tyre finds.",
    )


def _sweep_picture(sweep: Sequence[Mapping[str, float]]) -> Lines:
    x = tuple(SWEEP_RATIO.tolist())
    return Lines(
        title="What liars gain by what they say",
        x_axis=Axis("what three in ten say, over the friction of a new tyre", logarithmic=True),
        y_axis=Axis("mean shift, per cent"),
        lines=tuple(
            Line(name, x, tuple(100.0 * shift[name] for shift in sweep)) for name in (MEDIAN, POSTERIOR, LOOSE, REFINED)
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Say what the rules lose to liars."""
    figures = next(iter(results.values())).figures
    worst = {name: figures[f"worst_shift.{name}"] for name in COMPARED}
    least = min(worst, key=lambda name: worst[name])
    text = (
        f"Three liars in ten among fifty shift the published median by {100.0 * worst[MEDIAN]:.1f} % at worst, the "
        f"posterior alone by {100.0 * worst[POSTERIOR]:.1f} %, and held within 2 % of the median by "
        f"{100.0 * worst[REFINED]:.1f} %. The least is the {least}'s. "
    )
    if worst[MEDIAN] <= worst[REFINED]:
        text += "So the median is published, and the refined interval stands beside it. "
    else:
        text += "The refined interval bends less than the median here; the default rule deserves another look. "
    text += (
        f"A half-width that is told of three liars in ten holds the truth in "
        f"{100.0 * figures['half_width_holds_frac']:.0f} % of the windows with them."
    )
    return Verdict(Claim.NOT_CLAIMED, text)


CHAPTER = Chapter(
    name="liars",
    title="Vehicles that lie or are broken",
    paper_says="",
    compute=compute,
    verdict=verdict,
)
