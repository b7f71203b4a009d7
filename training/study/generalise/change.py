"""Friction that changes within the hour: how soon it is seen, how often in vain, and what it is worth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from roadgrip.units import WINDOW_S, FloatArray
from rsu_app.domain.change import ChangeKind, ChangePolicy, ChangeState, changes, mu_since_change, observe
from rsu_app.domain.interval import MEDIAN_TYRE_RATIO, median_of_ordered
from training.study.chapter import Arrays, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.generalise.passages import Traffic, drawn_passages
from training.study.picture import Axis, Line, Lines
from vehicle_client.simulator.plan import SensorGrade

POLICY = ChangePolicy()
BEFORE_MU = 0.5
DROPS_FRAC = (0.2, 0.4, 0.6)
VEHICLES_PER_HOUR = (10, 20, 40, 60)
BUSY_PER_HOUR = 60
RUNS_COUNT = 200
QUICK_RUNS_COUNT = 8
MONTH_HOURS = 720
MONTHS_COUNT = 12
QUICK_MONTHS_COUNT = 1
NOISES_RATIO = (0.05, 0.08, 0.10, 0.15)
LIE_RATIO = 0.5
"""What liars say over what there is: enough to look like ice."""
LIARS_FRAC = (0.0, 0.1, 0.3)
SLOW_HOURS = 3.0
SLOW_AFTER_RATIO = 0.5
HALF_HOUR_S = 1800.0

CHANGES: tuple[tuple[ChangeKind, float], ...] = (
    *((ChangeKind.DROP, round(1.0 - drop, 2)) for drop in DROPS_FRAC),
    (ChangeKind.RISE, 1.5),
    (ChangeKind.RISE, 2.5),
)
"""Sudden ones, and what they leave of the friction."""

Course = Callable[[FloatArray], FloatArray]
"""What a new tyre finds, by the time of its passage."""


@dataclass(frozen=True, slots=True)
class Drive:
    """Vehicles over a road whose friction changes.

    Attributes:
        left_at_s: When they left it; the change begins at zero. (n,)
        mu: Their estimates. (n,)
        mu_new: What a new tyre would have found. (n,)
    """

    left_at_s: FloatArray
    mu: FloatArray
    mu_new: FloatArray


PLAIN = "plain hour"
HALF = "plain half hour"
CUT = "hour, cut at changes"
REMEMBERING = "the same, watched for three hours"
MIDPOINTS = (PLAIN, HALF, CUT, REMEMBERING)
MEMORY_S = 3.0 * WINDOW_S


def published_mu(left_at_s: FloatArray, mu: FloatArray, *, now_s: float) -> dict[str, float]:
    """Return the middle that would be published by each rule, NaN where no vehicle counts.

    Args:
        left_at_s: When vehicles left the section, ascending, none after now. (n,)
        mu: Their estimates. (n,)
        now_s: Now.
    """
    hour, half, memory = (int(np.searchsorted(left_at_s, now_s - age_s)) for age_s in (WINDOW_S, HALF_HOUR_S, MEMORY_S))
    counted = {
        PLAIN: np.sort(mu[hour:]),
        HALF: np.sort(mu[half:]),
        CUT: mu_since_change(left_at_s[hour:], mu[hour:], policy=POLICY),
        REMEMBERING: mu_since_change(left_at_s[memory:], mu[memory:], policy=POLICY, counted_from_s=now_s - WINDOW_S),
    }
    return {name: median_of_ordered(values.tolist()) if len(values) else np.nan for name, values in counted.items()}


def driven(
    rng: np.random.Generator, course: Course, *, from_s: float, until_s: float, vehicles_per_hour: float
) -> Drive:
    """Return vehicles that come by chance, so many an hour in the mean.

    Args:
        rng: Source of chance.
        course: Friction by time.
        from_s: Time of the first.
        until_s: Time of the last.
        vehicles_per_hour: How many there are.
    """
    count = int(rng.poisson(vehicles_per_hour * (until_s - from_s) / 3600.0))
    left_at_s = np.sort(rng.uniform(from_s, until_s, count))
    mu_new = course(left_at_s)
    return Drive(left_at_s, mu_new * drawn_passages(rng, count, mu_new=1.0, traffic=Traffic()).mu, mu_new)


def sudden(after_ratio: float) -> Course:
    """Return friction that changes to so much of itself at zero."""
    return lambda left_at_s: np.where(left_at_s < 0.0, BEFORE_MU, after_ratio * BEFORE_MU)


def slow(after_ratio: float) -> Course:
    """Return friction that goes to so much of itself evenly in its logarithm, over some hours from zero."""
    return lambda left_at_s: BEFORE_MU * after_ratio ** np.clip(left_at_s / (3600.0 * SLOW_HOURS), 0.0, 1.0)


def seen_after_count(drive: Drive, kind: ChangeKind, *, memory_s: float) -> int | None:
    """Return how many vehicles after zero it took to see the change, None if it was not seen in the hour after.

    Args:
        drive: The vehicles.
        kind: Which way it went.
        memory_s: How far back the detector remembers at each moment.
    """
    for count, last in enumerate(np.flatnonzero(drive.left_at_s >= 0.0).tolist(), start=1):
        first = int(np.searchsorted(drive.left_at_s, drive.left_at_s[last] - memory_s))
        found = changes(drive.left_at_s[first : last + 1], drive.mu[first : last + 1], policy=POLICY)
        if found and found[-1].kind is kind and found[-1].seen_at_s >= 0.0:
            return count
    return None


def mean_error_ratio(drive: Drive, *, from_s: float, until_s: float) -> dict[str, float]:
    """Return by how much each published middle is off in the mean over the vehicles of a time, by name; NaN without.

    Args:
        drive: The vehicles.
        from_s: Begin of that time.
        until_s: Its end.
    """
    errors: dict[str, list[float]] = {name: [] for name in MIDPOINTS}
    for last in np.flatnonzero((drive.left_at_s >= from_s) & (drive.left_at_s < until_s)).tolist():
        middle_mu = MEDIAN_TYRE_RATIO * drive.mu_new[last]
        said = published_mu(drive.left_at_s[: last + 1], drive.mu[: last + 1], now_s=float(drive.left_at_s[last]))
        for name in MIDPOINTS:
            errors[name].append(abs(said[name] / middle_mu - 1.0))
    return {name: float(np.mean(values)) if values else np.nan for name, values in errors.items()}


def false_alarms_count(
    rng: np.random.Generator, *, vehicles_count: int, noise_ratio: float, liars_frac: float
) -> dict[ChangeKind, int]:
    """Return how many changes are seen in traffic over a road that does not change.

    Args:
        rng: Source of chance.
        vehicles_count: Vehicles, one after another.
        noise_ratio: Standard deviation of their relative errors.
        liars_frac: Share that says half of what there is.
    """
    traffic = Traffic(lowest_noise_ratio=noise_ratio, highest_noise_ratio=noise_ratio)
    mu = drawn_passages(rng, vehicles_count, mu_new=BEFORE_MU, traffic=traffic).mu
    mu = np.where(rng.random(vehicles_count) < liars_frac, LIE_RATIO * BEFORE_MU, mu)
    found = dict.fromkeys(ChangeKind, 0)
    state = ChangeState()
    for number, log_mu in enumerate(np.log(mu).tolist()):
        state, change = observe(state, log_mu=log_mu, at_s=float(number), policy=POLICY)
        if change is not None:
            found[change.kind] += 1
    return found


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Answer for vehicles of known errors; the sensors play no part, so all grades share what is computed."""
    del grade
    runs_count = QUICK_RUNS_COUNT if bench.quick else RUNS_COUNT
    months_count = QUICK_MONTHS_COUNT if bench.quick else MONTHS_COUNT
    figures = _remembered_figures(bench, runs_count=runs_count, months_count=months_count)
    return Result(
        figures=figures,
        sizes={"runs": runs_count, "months": months_count, "seed": bench.seed},
        tables=(_delay_table(figures), _error_table(figures), _alarm_table(figures)),
        pictures=(_picture(bench, max(5, runs_count // 4)),),
    )


def _remembered_figures(bench: Workbench, *, runs_count: int, months_count: int) -> dict[str, float]:
    def work() -> Arrays:
        figures: dict[str, float] = {}
        for done, (kind, after_ratio) in enumerate(CHANGES):
            bench.report("sudden changes", done, len(CHANGES))
            for rate in VEHICLES_PER_HOUR:
                found = _sudden(kind, after_ratio, rate, runs_count, bench.seed)
                figures |= {f"{_key(kind, after_ratio, rate)}.{name}": value for name, value in found.items()}
        for rate in VEHICLES_PER_HOUR:
            found = _slow(SLOW_AFTER_RATIO, rate, runs_count // 2, bench.seed)
            figures |= {f"slow_to_50.{rate}.error.{middle}": value for middle, value in found.items()}
        return {name: np.array(value) for name, value in (figures | _alarms(bench, months_count)).items()}

    return {name: float(value) for name, value in bench.remembered(f"change-{bench.seed}", work).items()}


def _key(kind: ChangeKind, after_ratio: float, rate: float) -> str:
    return f"{kind.value}_to_{round(100 * after_ratio)}.{rate}"


def _delay_table(figures: Mapping[str, float]) -> Table:
    names = ("median_count", "p90_count", "unseen_frac", "unseen_in_hour_frac")
    return Table(
        "How soon a change is seen",
        (
            "change",
            "vehicles per hour",
            "vehicles, median",
            "vehicles, 90 %",
            "share not seen",
            "the same, remembering an hour",
        ),
        tuple(
            (
                f"{kind.value} to {100 * after_ratio:.0f} %",
                rate,
                *(figures[f"{_key(kind, after_ratio, rate)}.{name}"] for name in names),
            )
            for kind, after_ratio in CHANGES
            for rate in VEHICLES_PER_HOUR
        ),
        "Counted from the first vehicle after the change, in the hour after it; the detector remembers three "
        "hours, and in the last column no more than the window holds.",
    )


def _error_table(figures: Mapping[str, float]) -> Table:
    rows = [
        (f"{kind.value} to {100 * after_ratio:.0f} %", rate, _key(kind, after_ratio, rate))
        for kind, after_ratio in CHANGES
        for rate in VEHICLES_PER_HOUR
    ]
    rows += [(f"to 50 % within {SLOW_HOURS:.0f} h", rate, f"slow_to_50.{rate}") for rate in VEHICLES_PER_HOUR]
    return Table(
        "Error of the published middle while friction changes, in per cent",
        ("change", "vehicles per hour", *MIDPOINTS),
        tuple((what, rate, *(100.0 * figures[f"{key}.error.{m}"] for m in MIDPOINTS)) for what, rate, key in rows),
        "Mean magnitude at every vehicle of the hour after a sudden change, or while a slow one lasts.",
    )


def _alarm_table(figures: Mapping[str, float]) -> Table:
    return Table(
        "False alarms in a month of 60 vehicles an hour",
        ("noise, per cent", "liars, per cent", "drops", "rises"),
        tuple(
            (
                100.0 * noise_ratio,
                100.0 * liars_frac,
                *(figures[f"{_alarm_key(noise_ratio, liars_frac)}.{kind.value}"] for kind in ChangeKind),
            )
            for noise_ratio in NOISES_RATIO
            for liars_frac in LIARS_FRAC
        ),
        "Steady road, 3 % outliers; liars say half of what there is.",
    )


def _sudden(kind: ChangeKind, after_ratio: float, rate: float, runs_count: int, seed: int) -> dict[str, float]:
    delays: list[float] = []
    unseen_in_hour: list[bool] = []
    errors: list[dict[str, float]] = []
    for number in range(runs_count):
        rng = np.random.default_rng([seed, number, round(100 * after_ratio), round(rate)])
        drive = driven(rng, sudden(after_ratio), from_s=-MEMORY_S, until_s=WINDOW_S, vehicles_per_hour=rate)
        count = seen_after_count(drive, kind, memory_s=MEMORY_S)
        delays.append(np.inf if count is None else count)
        unseen_in_hour.append(seen_after_count(drive, kind, memory_s=WINDOW_S) is None)
        errors.append(mean_error_ratio(drive, from_s=0.0, until_s=WINDOW_S))
    return {
        "median_count": _quantile(delays, 0.5),
        "p90_count": _quantile(delays, 0.9),
        "unseen_in_hour_frac": float(np.mean(unseen_in_hour)),
        "unseen_frac": float(np.mean(np.isinf(delays))),
        **{f"error.{middle}": float(np.nanmean([error[middle] for error in errors])) for middle in MIDPOINTS},
    }


def _slow(after_ratio: float, rate: float, runs_count: int, seed: int) -> dict[str, float]:
    errors = []
    for number in range(runs_count):
        rng = np.random.default_rng([seed, number, round(rate)])
        until_s = 3600.0 * SLOW_HOURS
        drive = driven(rng, slow(after_ratio), from_s=-MEMORY_S, until_s=until_s, vehicles_per_hour=rate)
        errors.append(mean_error_ratio(drive, from_s=0.0, until_s=until_s))
    return {middle: float(np.nanmean([error[middle] for error in errors])) for middle in MIDPOINTS}


def _alarms(bench: Workbench, months_count: int) -> dict[str, float]:
    figures: dict[str, float] = {}
    settings = [(noise_ratio, liars_frac) for noise_ratio in NOISES_RATIO for liars_frac in LIARS_FRAC]
    for done, (noise_ratio, liars_frac) in enumerate(settings):
        bench.report("months without a change", done, len(settings))
        found = false_alarms_count(
            np.random.default_rng([bench.seed, done]),
            vehicles_count=months_count * MONTH_HOURS * BUSY_PER_HOUR,
            noise_ratio=noise_ratio,
            liars_frac=liars_frac,
        )
        key = _alarm_key(noise_ratio, liars_frac)
        figures |= {f"{key}.{kind.value}": found[kind] / months_count for kind in ChangeKind}
    return figures


def _alarm_key(noise_ratio: float, liars_frac: float) -> str:
    return f"false_alarms.noise{round(100 * noise_ratio)}.liars{round(100 * liars_frac)}"


def _quantile(counts: list[float], share_frac: float) -> float:
    """Return a quantile among counts of which some may be infinite, for never; NaN if the quantile is never."""
    value = float(np.quantile(counts, share_frac, method="higher"))
    return value if np.isfinite(value) else np.nan


def _picture(bench: Workbench, runs_count: int) -> Lines:
    """Return what is published around a drop, in the mean over roads."""
    at_s = np.arange(-1200.0, WINDOW_S + 1.0, 120.0)

    def work() -> Arrays:
        said: dict[str, list[float]] = {name: [] for name in MIDPOINTS}
        for number in range(runs_count):
            rng = np.random.default_rng([bench.seed, number, 7])
            drive = driven(rng, sudden(0.6), from_s=-MEMORY_S, until_s=WINDOW_S, vehicles_per_hour=BUSY_PER_HOUR)
            for now_s in at_s.tolist():
                passed = int(np.searchsorted(drive.left_at_s, now_s, side="right"))
                now = published_mu(drive.left_at_s[:passed], drive.mu[:passed], now_s=now_s)
                for name in MIDPOINTS:
                    said[name].append(now[name])
        return {name: np.nanmean(np.reshape(mu, (runs_count, len(at_s))), axis=0) for name, mu in said.items()}

    minutes = tuple((at_s / 60.0).tolist())
    truth = tuple((MEDIAN_TYRE_RATIO * sudden(0.6)(at_s)).tolist())
    said = bench.remembered(f"change-picture-{bench.seed}", work)
    return Lines(
        title="What is published around a drop by 40 %, 60 vehicles an hour",
        x_axis=Axis("minutes after the drop"),
        y_axis=Axis("middle of the interval", low=0.2, high=0.5),
        lines=(
            Line("truth", minutes, truth, dashed=True),
            *(Line(name, minutes, tuple(said[name].tolist())) for name in MIDPOINTS),
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Say what the detector sees, misses and makes up."""
    figures = next(iter(results.values())).figures
    told = []
    for drop in DROPS_FRAC:
        name = f"drop_to_{round(100 * (1.0 - drop))}.{BUSY_PER_HOUR}"
        plain, cut = (100.0 * figures[f"{name}.error.{m}"] for m in (PLAIN, REMEMBERING))
        told.append(
            f"by {100.0 * drop:.0f} % after {figures[f'{name}.median_count']:.0f} vehicles (in the hour after it the "
            f"published middle is off by {cut:.0f} % instead of {plain:.0f} %)"
        )
    quiet = figures["false_alarms.noise5.liars0.drop"]
    noisy = figures["false_alarms.noise15.liars0.drop"]
    lied = figures["false_alarms.noise5.liars30.drop"]
    seldom = f"drop_to_60.{VEHICLES_PER_HOUR[0]}"
    seldom_plain, seldom_cut = (100.0 * figures[f"{seldom}.error.{m}"] for m in (PLAIN, REMEMBERING))
    slow_plain, slow_cut, slow_half = (
        100.0 * figures[f"slow_to_50.{BUSY_PER_HOUR}.error.{m}"] for m in (PLAIN, REMEMBERING, HALF)
    )
    text = (
        f"At {BUSY_PER_HOUR} vehicles an hour a drop is seen {', '.join(told)}. A month without a change has "
        f"{quiet:.1f} false alarms at 5 % noise, {noisy:.1f} at 15 %, and {lied:.0f} if three vehicles in ten say half "
        f"of what there is. At {VEHICLES_PER_HOUR[0]} vehicles an hour a drop by 40 % leaves {seldom_cut:.0f} % "
        f"instead of {seldom_plain:.0f} %; there the newest ten vehicles are nearly the hour. While friction "
        f"halves within {SLOW_HOURS:.0f} hours the plain hour is off by {slow_plain:.0f} %, the cut one by "
        f"{slow_cut:.0f} %, half an hour by {slow_half:.0f} %. "
    )
    text += (
        "The option does what it is for."
        if quiet < 1.0 and unseen_at_most(figures, 0.05)
        else "The option is not yet fit for use."
    )
    return Verdict(Claim.NOT_CLAIMED, text)


def unseen_at_most(figures: Mapping[str, float], share_frac: float) -> bool:
    """Return whether on a busy road hardly any drop goes unseen."""
    return all(
        figures[f"drop_to_{round(100 * (1.0 - drop))}.{BUSY_PER_HOUR}.unseen_frac"] <= share_frac for drop in DROPS_FRAC
    )


CHAPTER = Chapter(
    name="change",
    title="Friction that changes within the hour",
    paper_says="",
    compute=compute,
    verdict=verdict,
)
