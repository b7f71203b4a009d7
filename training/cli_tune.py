"""The command that fits the constants of the onboard estimation to a vehicle."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from roadgrip.errors import ConfigurationError
from roadgrip.sections import read_section
from training.cli_designs import AsJson, Grade, Kind, Seed, console, progress_bar
from training.observer_tuning import (
    Tuning,
    tunable_ranges,
    tune,
    usual_constants,
)
from training.reference_drives import (
    MAPPINGS,
    ReferenceDrive,
    ReferenceFormat,
    parts_of_recording,
    recording_with_reference,
    simulated_drives,
)
from training.scenarios import Terms
from vehicle_client.estimation.observer import ObserverParameters
from vehicle_client.simulator.plan import DriverKind, SensorGrade
from vehicle_client.vehicle_profile import PAPER_VEHICLE, VehicleProfile, profile_of_toml, toml_of_profile

DEFAULT_TUNE_SEED = 1
DEFAULT_EVALUATIONS_COUNT = 600
DEFAULT_HELD_OUT_FRAC = 0.5
DEFAULT_BASE_FRICTIONS_MU = (0.3, 0.5, 0.8)
_PICTURES = (".svg", ".png", ".pdf")


def tune_observer(  # noqa: PLR0917 - typer reads options by name
    recording: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="A recorded drive with a reference; repeatable, all of one vehicle."),
    ] = None,
    recorded_as: Annotated[
        ReferenceFormat, typer.Option("--format", help="Whose recordings they are.")
    ] = ReferenceFormat.ROADGRIP,
    simulate: Annotated[
        int | None, typer.Option(metavar="N", min=2, help="Instead: so many simulated drives per friction and road.")
    ] = None,
    section: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Road of the simulated drives, or a section file; repeatable.",
            show_default="long-turn",
        ),
    ] = None,
    base_friction: Annotated[
        list[float] | None,
        typer.Option(
            metavar="MU",
            min=0.05,
            max=1.5,
            help="Of the simulated drives; repeatable.",
            show_default=", ".join(map(str, DEFAULT_BASE_FRICTIONS_MU)),
        ),
    ] = None,
    sensors: Grade = SensorGrade.AUTOMOTIVE,
    driver: Kind = DriverKind.PRUDENT,
    vehicle: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Vehicle file to start from; the paper's constants if left out.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Vehicle file to write.")] = None,
    constant: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Constant to tune; repeatable.", show_default="all that shape the sideslip"),
    ] = None,
    held_out: Annotated[
        float,
        typer.Option(
            metavar="SHARE",
            min=0.0,
            max=0.9,
            help="Of every recording (its end), or of the drives, to judge on and not to tune on.",
        ),
    ] = DEFAULT_HELD_OUT_FRAC,
    evaluations: Annotated[
        int, typer.Option(metavar="N", min=2, help="Sets of constants to try.")
    ] = DEFAULT_EVALUATIONS_COUNT,
    seed: Seed = DEFAULT_TUNE_SEED,
    accept_worse: Annotated[
        bool, typer.Option("--accept-worse", help="Keep the tuned constants even if what was held out became worse.")
    ] = False,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help=f"Draw truth, before and after: {', '.join(_PICTURES)}."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Fit the constants of the onboard estimation to a vehicle: least RMS error of sideslip against a reference.

    Judges on what was held out, and keeps the constants it started from (and writes those) unless that became better.
    Our own recordings need the columns reference_velocity_x_mps and reference_velocity_y_mps.

    Example: roadgrip-train tune-observer --recording lap.csv.gz --vehicle car.toml --out tuned.toml
    """
    if (simulate is None) == (not recording):
        raise typer.BadParameter(
            "give recordings, or how many drives to simulate", param_hint="--recording, --simulate"
        )
    if plot is not None and plot.suffix not in _PICTURES:
        raise typer.BadParameter(f"{plot} must end in one of {', '.join(_PICTURES)}", param_hint="--plot")
    start = _profile(vehicle, recorded_as, simulated=simulate is not None)
    names = tuple(constant or usual_constants())
    unknown = sorted(set(names) - set(tunable_ranges(start.parameters)))
    if unknown:
        known = ", ".join(tunable_ranges(start.parameters))
        raise typer.BadParameter(f"no constant {', '.join(unknown)}; there are {known}", param_hint="--constant")
    if recording:
        parts = [_parts(path, recorded_as, start, held_out) for path in recording]
    else:
        roads = section or ["long-turn"]
        terms = Terms("tune-observer", seed, sensors, driver)
        parts = [
            _simulated(road, terms, start, mu=mu, drives_count=simulate or 0, held_out_frac=held_out)
            for road in roads
            for mu in base_friction or DEFAULT_BASE_FRICTIONS_MU
        ]
    tuned_on = [drive for first, _ in parts for drive in first]
    judged_on = [drive for _, rest in parts for drive in rest]
    tuning = _tune(tuned_on, judged_on, start.parameters, names, evaluations_count=evaluations, seed=seed)
    kept = tuning.found.parameters if accept_worse else tuning.kept
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        profile = replace(start, parameters=kept)
        out.write_text(toml_of_profile(profile), encoding="utf-8")
    if plot is not None:
        from training.tuning_picture import draw_tuning

        plot.parent.mkdir(parents=True, exist_ok=True)
        shown = max(judged_on or tuned_on, key=lambda drive: drive.judged_s)
        draw_tuning(shown, before=start.parameters, after=tuning.found.parameters, path=plot)
    if as_json:
        typer.echo(json.dumps(_document(tuning, names)))
    else:
        _print(tuning, names)
        if out is not None:
            typer.echo(f"{out}: {start.name}")
    if not tuning.improved:
        decision = "kept all the same" if accept_worse else "the constants stay as they were"
        where = "what was held out" if judged_on else "what was tuned on"
        console.print(f"[yellow]warning:[/yellow] {where} did not become better; {decision}", highlight=False)


def _profile(path: Path | None, recorded_as: ReferenceFormat, *, simulated: bool) -> VehicleProfile:
    if path is not None:
        return profile_of_toml(path.read_text(encoding="utf-8"), place=str(path))
    if simulated or recorded_as is ReferenceFormat.ROADGRIP:
        return PAPER_VEHICLE
    return VehicleProfile(name=recorded_as.value, geometry=MAPPINGS[recorded_as].vehicle)


def _parts(
    path: Path, recorded_as: ReferenceFormat, start: VehicleProfile, held_out_frac: float
) -> tuple[list[ReferenceDrive], list[ReferenceDrive]]:
    recording = recording_with_reference(path.read_bytes(), recorded_as, place=path.name)
    first, rest = parts_of_recording(recording, name=path.name, vehicle=start.geometry, tuned_frac=1.0 - held_out_frac)
    return [first], [] if rest is None else [rest]


def _simulated(
    road: str, terms: Terms, start: VehicleProfile, *, mu: float, drives_count: int, held_out_frac: float
) -> tuple[list[ReferenceDrive], list[ReferenceDrive]]:
    section = read_section(road)
    with console.status(f"driving {section.section_id} at {mu:.2f}"):
        drives = simulated_drives(
            section, terms, base_friction_mu=mu, drives_count=drives_count, vehicle=start.geometry
        )
    if len(drives) < drives_count:
        raise ConfigurationError(
            f"only {len(drives)} of {drives_count} drives came over {section.section_id} at a friction of {mu:.2f}; "
            f"ask for more grip"
        )
    # At least one drive on either side, if any are to be held out.
    count = drives_count - (max(1, round(held_out_frac * drives_count)) if held_out_frac > 0.0 else 0)
    return drives[: max(count, 1)], drives[max(count, 1) :]


def _tune(
    tuned_on: list[ReferenceDrive],
    held_out: list[ReferenceDrive],
    start: ObserverParameters,
    names: tuple[str, ...],
    *,
    evaluations_count: int,
    seed: int,
) -> Tuning:
    with progress_bar() as bar:
        task = bar.add_task("trying constants", total=evaluations_count, rate="")

        def show(count: int, best_rad: float) -> None:
            bar.update(task, completed=count, rate=f"{math.degrees(best_rad):.3f} deg")

        return tune(
            tuned_on,
            held_out,
            start,
            constants=names,
            evaluations_limit_count=evaluations_count,
            seed=seed,
            on_evaluation=show,
        )


def _print(tuning: Tuning, names: tuple[str, ...]) -> None:
    shown = Table("sideslip error, deg RMS", "seconds", "claiming none", "before", "after", "correlation")
    for what, judged in (("tuned on", tuning.tuned), ("held out", tuning.held_out)):
        if judged is not None:
            before, after = judged
            errors = (f"{math.degrees(rad):.3f}" for rad in (before.truth_rms_rad, before.rms_rad, after.rms_rad))
            correlations = f"{before.correlation:.3f} to {after.correlation:.3f}"
            shown.add_row(what, f"{before.judged_s:.0f}", *errors, correlations)
    Console().print(shown)
    constants = Table("constant", "before", "after", "")
    for name in names:
        before_and_after = (f"{getattr(p, name):.4g}" for p in (tuning.start, tuning.found.parameters))
        constants.add_row(name, *before_and_after, "at its bound" if name in tuning.found.at_bounds else "")
    Console().print(constants)


def _document(tuning: Tuning, names: tuple[str, ...]) -> dict[str, Any]:
    judged = {"tuned": tuning.tuned, "held_out": tuning.held_out}
    return {
        "improved": tuning.improved,
        "evaluations_count": tuning.found.evaluations_count,
        "at_bounds": list(tuning.found.at_bounds),
        **{
            what: None if both is None else {"before": asdict(both[0]), "after": asdict(both[1])}
            for what, both in judged.items()
        },
        "constants": {
            name: {"before": getattr(tuning.start, name), "after": getattr(tuning.found.parameters, name)}
            for name in names
        },
    }
