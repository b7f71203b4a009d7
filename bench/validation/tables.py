"""The tables of the validation page, from the kept figures; the page marks where each goes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.simulator_oracle import OracleCar, Variant
from bench.validation import bounds
from training.marked_tables import percent as _percent
from training.marked_tables import table as _table
from training.marked_tables import with_tables

Figures = Mapping[str, Any]


def page_with_tables(page: str, figures: Figures) -> str:
    """Return a page with its marked tables written anew.

    Args:
        page: Markdown with `<!-- table: name -->` and `<!-- end of table -->` around every table.
        figures: What `validation.json` holds.

    Raises:
        KeyError: A mark names no table.
    """
    makers = {
        "tyre": _tyre,
        "body": _body,
        "lateral": _lateral,
        "longitudinal": _longitudinal,
        "abs": _abs,
        "esc": _esc,
        "time_step": _time_step,
        "roughness": _roughness,
        "oracle_steps": _oracle_steps,
        "oracle_others": _oracle_others,
    }
    return with_tables(page, lambda name: makers[name](figures))


def _tyre(figures: Figures) -> str:
    tyre = figures["tyre"]
    rows = [
        [f"published {what}, {word}", f"{tyre[f'published_points_{axis}'][f'{what}_largest_error_ratio']:.0e}", "1e-4"]
        for axis, word in (("x", "longitudinal"), ("y", "lateral"))
        for what in ("slope", "peak", "slide")
    ]
    rows += [
        ["F(s; mu) against mu F(s / mu; 1)", f"{tyre['self_similarity_largest_deviation_ratio']:.0e}", "1e-9"],
        [
            "largest force in combined slip over mu times load",
            f"{tyre['combined_slip']['largest_force_over_mu_load_ratio']:.4f}",
            "1",
        ],
        *(
            [f"peak force over load at twice the load, {word}", f"{tyre['load_sensitivity'][key]:.3f} of nominal", ""]
            for key, word in (
                ("peak_at_twice_the_load_x_ratio", "longitudinal"),
                ("peak_at_twice_the_load_y_ratio", "lateral"),
            )
        ),
    ]
    return _table(("what", "largest relative error, or value", "bound"), rows)


def _body(figures: Figures) -> str:
    body = figures["body"]
    circle, step, poles = body["steady_circle"], body["step_steer"], body["eigenvalues"]
    rows = [
        (
            f"understeer gradient over the linear one ({circle['linear_gradient_deg_per_g']:.2f} °/g)",
            circle["gradient_over_linear_ratio"] - 1.0,
            bounds.UNDERSTEER_RATIO,
        ),
        (
            f"roll angle over springs and weight ({body['roll']['gradient_deg_per_g']:.1f} °/g)",
            body["roll"]["largest_error_ratio"],
            bounds.ROLL_RATIO,
        ),
        (
            "step steer against the linear single-track model, over the peak",
            step["largest_deviation_over_peak_ratio"],
            bounds.STEP_STEER_RATIO,
        ),
        ("natural frequency, 15 to 35 m/s", poles["frequency_largest_error_ratio"], bounds.EIGENVALUE_RATIO),
        ("damping, 15 to 35 m/s", poles["damping_largest_error_ratio"], bounds.EIGENVALUE_RATIO),
        (
            "energy that is missing when rolling out, over the loss",
            body["free_roll"]["largest_residual_over_loss_ratio"],
            bounds.FREE_ROLL_RATIO,
        ),
    ]
    return _table(
        ("what", "largest difference", "bound"),
        [[text, _percent(found, digits=2), _percent(bound)] for text, found, bound in rows],
    )


def _lateral(figures: Figures) -> str:
    rows = figures["limits"]["lateral"]
    lines = []
    for bank in sorted({row["bank_ratio"] for row in rows}):
        some = [row for row in rows if row["bank_ratio"] == bank]
        for key, word in (
            ("over_load_sensitive_limit_ratio", "over the load-sensitive limit"),
            ("over_mu_g_ratio", "over mu g and bank"),
        ):
            lines.append([f"bank {100 * bank:.0f} %, {word}", *(f"{row[key]:.3f}" for row in some)])
    mus = [f"{row['mu']:g}" for row in rows if row["bank_ratio"] == 0.0]
    return _table(("mu", *mus), lines)


def _longitudinal(figures: Figures) -> str:
    rows = figures["limits"]["longitudinal"]
    lines = [
        [f"{word}, {text}", *(f"{row[f'{word}_{key}']:.3f}" for row in rows)]
        for word in ("braking", "driving")
        for key, text in (
            ("balanced_over_limit_ratio", "torque shared like the load, over the limit"),
            ("balanced_over_mu_g_ratio", "the same over mu g"),
            ("own_split_over_limit_ratio", "the car's own split, over the limit"),
        )
    ]
    return _table(("mu", *(f"{row['mu']:g}" for row in rows)), lines)


def _abs(figures: Figures) -> str:
    rows = figures["limits"]["abs"]
    lines = [
        ["ideal, m", *(f"{row['ideal_m']:.1f}" for row in rows)],
        ["with ABS, m", *(f"{row['abs_m']:.1f}" for row in rows)],
        ["locked wheels, m", *(f"{row['locked_m']:.1f}" for row in rows)],
        ["ideal over ABS", *(_percent(row["abs_efficiency_ratio"], digits=0) for row in rows)],
        ["ideal over locked", *(_percent(row["locked_efficiency_ratio"], digits=0) for row in rows)],
    ]
    return _table(("mu", *(f"{row['mu']:g}" for row in rows)), lines)


def _esc(figures: Figures) -> str:
    rows = figures["limits"]["on_the_road"]
    mus = sorted({row["mu"] for row in rows})
    lines = []
    for driver in ("prudent", "reacting"):
        for esc in ("on", "off"):
            some = sorted((r for r in rows if r["driver"] == driver and r["esc"] == esc), key=lambda r: float(r["mu"]))
            for key, word in (("on_the_road_frac", "on the road"), ("spun_frac", "spun")):
                lines.append([f"{driver}, ESC {esc}: {word}", *(_percent(r[key], digits=0) for r in some)])
    return _table(("base friction", *(f"{mu:g}" for mu in mus)), lines)


def _time_step(figures: Figures) -> str:
    lines = []
    for key, word in (
        ("motion_statistics_over_largest_magnitude", "statistics of the motion, over the signal's largest magnitude"),
        ("summary_values_over_their_spread", "summary values, over their spread between drives"),
    ):
        for step, found in figures["time_step"][key].items():
            lines.append(
                [f"{step.removeprefix('step_').replace('_', ' ')}: {word}"]
                + [_percent(found[q], digits=2) for q in ("q50_ratio", "q95_ratio", "q99_ratio", "largest_ratio")]
            )
    return _table(("against 0.5 ms", "median", "95 %", "99 %", "largest"), lines)


def _roughness(figures: Figures) -> str:
    rough = figures["roughness"]
    lines = [
        [
            f"class {name.upper()}",
            " to ".join(f"{rough[f'class_{name}'][f'{end}_over_middle_ratio']:.2f}" for end in ("lowest", "highest")),
            _percent(rough[f"class_{name}"]["inside_band_frac"], digits=0),
        ]
        for name in "abcd"
    ]
    return _table(("", "spectrum over the middle of the class (its band is 0.5 to 2)", "inside the band"), lines)


def _oracle_steps(figures: Figures) -> str:
    lines = []
    for variant in Variant:
        for car in OracleCar:
            found = figures["oracle"][car.name.lower()][variant.name.lower()]
            steps = [f for name, f in found.items() if name.startswith("step_")]
            cells = [f"{variant.value}: {car.value}"]
            cells += [
                _span([f["over_ratio"][key] for f in steps])
                for key in ("steady_yaw_rate_radps", "peak_yaw_rate_radps", "steady_accel_y_mps2", "steady_roll_rad")
            ]
            over = [f["ours"]["overshoot_ratio"] - f["theirs"]["overshoot_ratio"] for f in steps]
            rise = [1e3 * (f["ours"]["rise_time_s"] - f["theirs"]["rise_time_s"]) for f in steps]
            cells += [_span(over), f"{min(rise):+.0f} … {max(rise):+.0f} ms"]
            lines.append(cells)
        lines.append(
            [
                "bound",
                *([f"**{_percent(bounds.STEADY_RATIO[variant], digits=0)}**"] * 4),
                f"**{_percent(bounds.OVERSHOOT_RATIO[variant])}**",
                f"**{1e3 * bounds.RISE_TIME_S[variant]:.0f} ms**",
            ]
        )
    head = ("step steer: ours over theirs", "steady yaw rate", "peak yaw rate", "lateral acceleration", "roll",
            "overshoot (difference)", "rise time (difference)")  # fmt: skip
    return _table(head, lines)


def _oracle_others(figures: Figures) -> str:
    lines = []
    for variant in Variant:
        for car in OracleCar:
            found = figures["oracle"][car.name.lower()][variant.name.lower()]
            lanes = [f for name, f in found.items() if "lane_change" in name]
            steer = [v for key, v in found["circle"]["over_ratio"].items() if key.startswith("steer")]
            stops = [f["over_ratio"] for name, f in found.items() if name.startswith("braking")]
            lines.append(
                [
                    f"{variant.value}: {car.value}",
                    _span(steer),
                    _span([f["peak_yaw_rate_over_ratio"] for f in lanes]),
                    _span([f["peak_accel_y_over_ratio"] for f in lanes]),
                    _percent(max(f["yaw_rate_rms_over_peak_ratio"] for f in lanes)),
                    _span([f["yaw_rate_lag_s"] for f in lanes], unit=" ms", factor=1e3, digits=0),
                    _span(stops, digits=2),
                ]
            )
        lines.append(
            [
                "bound",
                f"**{_percent(bounds.STEADY_RATIO[variant], digits=0)}**",
                *([f"**{_percent(bounds.LANE_CHANGE_PEAK_RATIO[variant])}**"] * 2),
                f"**{_percent(bounds.LANE_CHANGE_RMS_RATIO[variant])}**",
                "",
                f"**{_percent(bounds.BRAKING_RATIO)}**",
            ]
        )
    head = ("ours over theirs", "circle: steering angle", "lane changes: peak yaw rate", "peak lateral acceleration",
            "yaw rate, rms over peak", "lag of ours", "braking distance")  # fmt: skip
    return _table(head, lines)


def _span(values: Sequence[float], *, unit: str = " %", factor: float = 100.0, digits: int = 1) -> str:
    low, high = factor * min(values), factor * max(values)
    return f"{low:+.{digits}f} … {high:+.{digits}f}{unit}"
