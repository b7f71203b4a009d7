"""roadgrip-train: drives with known friction become the model that road side units run.

Four steps (simulate, fit, export, bundle), each leaving its result on disk, or all of them at once::

    roadgrip-train designs                            list what can be driven
    roadgrip-train simulate --out build/runs          drive a design, write Parquet
    roadgrip-train cells build/runs                   say how the drives ended, cell by cell
    roadgrip-train fit build/runs --out build/fit     grow trees, judge them on runs they never saw
    roadgrip-train export build/fit --out model.onnx  convert, and prove that nothing changed
    roadgrip-train bundle build/runs --fit build/fit --out build/bundle

The operators' loop (docs/operators.md), in a laboratory's folder::

    roadgrip-train data add|join|holdouts             drives with known friction, by their digests
    roadgrip-train retrain --data winter              a challenger, with its records in mlflow
    roadgrip-train gate --challenger challenger       hold it against the champion
    roadgrip-train promote --ring canary --keys K     sign it, publish it
    roadgrip-train drift EXPORT... --bundle B         say whether it is time to train again

And besides::

    roadgrip-train default-bundle                     remake the bundle that comes with roadgrip
    roadgrip-train card build/bundle                  what a bundle is for, learned from, and worth
    roadgrip-train tune-observer                      fit the onboard estimation to a vehicle
    roadgrip-train study paper                        the paper's every result, and `study generalise` past it
    roadgrip-train evaluate --traces drives           say what a bundle makes of anybody's recorded drives
"""

from __future__ import annotations

import json
from concurrent.futures import BrokenExecutor
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from roadgrip.bundle import BundleManifest
from roadgrip.errors import RoadgripError
from roadgrip.features import TABLES, FeatureTable
from training.cli_bundle import BUNDLE_NAME, card, default_bundle, tools_provenance
from training.cli_data import data_app
from training.cli_designs import AsJson, cells, console, designs, progress_bar, simulate
from training.cli_drift import drift
from training.cli_evaluate import evaluate
from training.cli_gate import gate
from training.cli_ground_truth import ground_truth_app
from training.cli_keys import keys_app
from training.cli_ledger import ledger_app
from training.cli_promote import promote, refresh, repository_app, sign
from training.cli_retrain import models_app, retrain, ui
from training.cli_study import study_app
from training.cli_tune import tune_observer
from training.dataset import Runs, read_runs
from training.fit_parameters import FitParameters

# Trees and ONNX take seconds to import: they are where they are needed.
if TYPE_CHECKING:
    from training.regressor import Fitted

DEFAULT_FIT = FitParameters()

app = typer.Typer(
    name="roadgrip-train",
    # A backspace alone on a line keeps what follows from being filled like prose.
    help=(__doc__ or "").replace("::\n", ":\n").replace("\n\n    ", "\n\n\b\n    "),
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"roadgrip {version('roadgrip')}")
        raise typer.Exit


@app.callback()
def _root(
    show_version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Turn drives with known friction into the model that road side units run."""


Trees = Annotated[int, typer.Option("--trees", min=1, help="Boosting rounds.")]
Depth = Annotated[int, typer.Option("--depth", min=1, max=12, help="Levels of one tree.")]
RunsFolder = Annotated[Path, typer.Argument(help="Folder of Parquet shards, or one Parquet file.")]


app.command()(simulate)
app.command()(designs)
app.command()(cells)
app.command()(tune_observer)
app.add_typer(study_app)
app.command()(evaluate)
app.command()(default_bundle)
app.command()(card)
for command in (retrain, gate, promote, sign, refresh, drift, ui):
    app.command()(command)
for group in (data_app, ground_truth_app, models_app, keys_app, repository_app, ledger_app):
    app.add_typer(group)


@app.command(name="fit")
def fit_command(
    data: RunsFolder,
    *,
    out: Annotated[Path, typer.Option("--out", help="Folder for the trees.")],
    table: Annotated[
        int | None, typer.Option("--table", help="Version of the feature table.", show_default="the runs' own")
    ] = None,
    trees: Trees = DEFAULT_FIT.trees_count,
    depth: Depth = DEFAULT_FIT.depth_count,
    seed: Annotated[int, typer.Option(min=0, help="Of the split and of the trees.")] = DEFAULT_FIT.seed,
    as_json: AsJson = False,
) -> None:
    """Fit boosted trees to nine tenths of the runs and judge them on the rest.

    Example: roadgrip-train fit build/ideal --out build/fit
    """
    from training.fit_files import write_fit

    runs = read_runs(data)
    if table is not None:
        runs = runs.for_table(_table_of_version(table))
    parameters = FitParameters(trees_count=trees, depth_count=depth, seed=seed)
    fitted = _fit(runs, parameters)
    write_fit(fitted, out, runs=runs, parameters=parameters)
    _print_metrics(fitted.metrics, as_json=as_json)


@app.command()
def export(
    fit_folder: Annotated[Path, typer.Argument(help="What `fit` wrote.")],
    out: Annotated[Path, typer.Option("--out", help="The ONNX file.")],
    data: Annotated[Path, typer.Option("--data", help="The runs it was fitted to: both models must agree on them.")],
    as_json: AsJson = False,
) -> None:
    """Convert the trees to ONNX; nothing is written unless both answer alike on thousands of rows.

    Example: roadgrip-train export build/fit --data build/ideal --out build/model.onnx
    """
    from training.export import check_parity, parity_rows, to_onnx
    from training.fit_files import fitted_table, read_trees

    trees = read_trees(fit_folder)
    runs = read_runs(data).for_table(fitted_table(fit_folder))
    model = to_onnx(trees, table=runs.table)
    rows = parity_rows(runs.features[runs.usable], rng=np.random.default_rng(0), table=runs.table)
    difference_mu = check_parity(trees, model, rows, table=runs.table)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(model)
    if as_json:
        typer.echo(json.dumps({"rows_count": len(rows), "largest_difference_mu": difference_mu, "bytes": len(model)}))
    else:
        typer.echo(f"{out}: {len(model) / 1e6:.2f} MB; differs from the trees by at most {difference_mu:.1e}")


@app.command()
def bundle(
    data: RunsFolder,
    fit_folder: Annotated[Path, typer.Option("--fit", help="What `fit` wrote for these runs.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the bundle.")],
    name: Annotated[str, typer.Option(help="Name of the bundle.")] = BUNDLE_NAME,
    as_json: AsJson = False,
) -> None:
    """Make a bundle that a road side unit can load: model, envelope, golden vectors, figures, provenance.

    Example: roadgrip-train bundle build/ideal --fit build/fit --out build/bundle
    """
    from training.fit_files import fitted_table, read_fit

    runs = read_runs(data).for_table(fitted_table(fit_folder))
    fitted, parameters = read_fit(fit_folder, runs=runs)
    manifest = _bundle(runs, fitted, out, name=name, command="roadgrip-train bundle", parameters=parameters)
    _print_bundle(manifest, out, as_json=as_json)


def run() -> None:
    """Run the command line; an error of ours is one clear line and exit code 2."""
    try:
        app()
    except RoadgripError as error:
        _leave(str(error))
    except BrokenExecutor:
        _leave("a worker was killed, perhaps for want of memory; give the command again, with fewer --workers")
    except OSError as error:  # a file or folder that was named and cannot be used
        _leave(str(error) if error.filename is None else f"cannot use {error.filename}: {error.strerror}")


def _leave(reason: str) -> NoReturn:
    # As it is, not wrapped: a path shall stay in one piece.
    console.print(Text.assemble(("error: ", "red"), reason), highlight=False, soft_wrap=True)
    raise SystemExit(2)


def _table_of_version(number: int) -> FeatureTable:
    spoken = {table.version: table for table in TABLES.values()}
    if number not in spoken:
        known = ", ".join(str(each) for each in sorted(spoken))
        raise typer.BadParameter(f"no feature table {number}; there are {known}", param_hint="--table")
    return spoken[number]


def _fit(runs: Runs, parameters: FitParameters) -> Fitted:
    from training.accuracy import FEWEST_ROADS
    from training.regressor import ROAD_FOLDS_COUNT, fit, mape_ratio_on_unseen_roads

    with progress_bar() as bar:
        task = bar.add_task(f"growing trees on {int(runs.usable.sum())} runs", total=parameters.trees_count, rate="")
        fitted = fit(runs, parameters, on_round=lambda done: bar.update(task, completed=done))
        if len(set(runs.section_id)) < FEWEST_ROADS:
            return fitted
        folds = bar.add_task("judging on roads that were not learned", total=ROAD_FOLDS_COUNT, rate="")
        unseen = mape_ratio_on_unseen_roads(runs, parameters, on_fold=lambda done: bar.update(folds, completed=done))
    return replace(fitted, metrics={**fitted.metrics, "mape_ratio_unseen_roads": unseen})


def _bundle(
    runs: Runs, fitted: Fitted, out: Path, *, name: str, command: str, parameters: FitParameters
) -> BundleManifest:
    from training.bundling import write_bundle

    provenance = {"command": command, "fit_parameters": str(parameters), **tools_provenance()}
    return write_bundle(runs, fitted, out, name=name, provenance=provenance, rng=np.random.default_rng(parameters.seed))


def _print_metrics(metrics: dict[str, float], *, as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps(metrics))
        return
    roads = {name.split(".", 1)[1]: value for name, value in metrics.items() if name.startswith("mape_ratio.")}
    title = f"On {metrics['rows_count']:.0f} runs that were not learned from"
    table = Table("road", "MAPE %", title=title, min_width=len(title))
    table.add_row("all", f"{100 * metrics['mape_ratio']:.2f}")
    for road, value in roads.items():
        if not road.startswith("random-"):
            table.add_row(road, f"{100 * value:.2f}")
    if "mape_ratio_unseen_roads" in metrics:
        table.add_row("roads never seen (mean)", f"{100 * metrics['mape_ratio_unseen_roads']:.2f}")
    table.caption = f"relative RMS {100 * metrics['relative_rms_ratio']:.2f} %"
    Console().print(table)


def _print_bundle(manifest: BundleManifest, folder: Path, *, as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps({"bundle_id": manifest.bundle_id, "folder": str(folder), "metrics": manifest.metrics}))
        return
    _print_metrics(manifest.metrics, as_json=False)
    typer.echo(f"bundle {manifest.name} {manifest.bundle_id} in {folder}")
    for model in manifest.models:
        typer.echo(
            f"feature table {model.table_digest}: friction {model.mu_range[0]:.2f} to {model.mu_range[1]:.2f}; "
            f"{model.envelope.outside_allowed_count} features may lie outside the envelope"
        )
