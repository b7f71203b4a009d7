"""`roadgrip-train retrain`, `ui` and `models`: from data sets to a registered challenger, and a look at the records."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from roadgrip.bundle import MANIFEST_NAME
from roadgrip.bundle_json import manifest_from_json
from roadgrip.errors import ConfigurationError
from training.bundle_card import card_of
from training.cli_bundle import BUNDLE_NAME, shown_on, tools_provenance
from training.cli_designs import AsJson, console, progress_bar
from training.fit_parameters import FitParameters
from training.laboratory import DEFAULT_FOLDER, LAB_VARIABLE, Laboratory
from training.retraining.registry import (
    ADDRESS_VARIABLE,
    CHALLENGER,
    MODEL_NAME,
    RegisteredModel,
    address_of,
    models,
    registered,
    set_alias,
    shown_address,
)

# Trees and mixtures take seconds to import: they are where they are needed.
if TYPE_CHECKING:
    from training.retraining.retrain import Retrained

DEFAULT_PORT = 5000
_ENDING_S = 10.0

models_app = typer.Typer(
    name="models", help="Look at the register of models, and name its versions.", no_args_is_help=True
)

Lab = Annotated[Path, typer.Option("--lab", metavar="FOLDER", envvar=LAB_VARIABLE, help="The laboratory's folder.")]
Tracking = Annotated[
    str | None,
    typer.Option(
        "--tracking",
        metavar="URL",
        envvar=ADDRESS_VARIABLE,
        help="An mlflow server, or a database.",
        show_default="an SQLite file in --lab",
    ),
]


def retrain(  # noqa: PLR0917 - typer reads options by name
    data: Annotated[
        list[str], typer.Option("--data", metavar="REF", help="Data set of the shelf: digest or name; repeatable.")
    ],
    lab: Lab = DEFAULT_FOLDER,
    experiment: Annotated[
        str, typer.Option("--experiment", metavar="NAME", help="Under which name mlflow keeps the run.")
    ] = MODEL_NAME,
    tracking: Tracking = None,
    tables: Annotated[
        list[int] | None,
        typer.Option(metavar="VERSION", help="Feature table that gets a model; repeatable.", show_default="all"),
    ] = None,
    trees: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Boosting rounds.", show_default="the study's")
    ] = None,
    depth: Annotated[
        int | None, typer.Option(metavar="N", min=1, max=12, help="Levels of a tree.", show_default="the study's")
    ] = None,
    local: Annotated[
        list[str] | None, typer.Option(metavar="SECTION", help="Section that gets a model of its own; repeatable.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of folds, fresh roads and trees.")] = FitParameters().seed,
    name: Annotated[str, typer.Option(help="Name of the bundle.")] = BUNDLE_NAME,
    reason: Annotated[str, typer.Option(metavar="TEXT", help="Why, for the ledger.")] = "",
    out: Annotated[Path | None, typer.Option("--out", metavar="FOLDER", help="Write the bundle there, too.")] = None,
    as_json: AsJson = False,
) -> None:
    """Retrain on data sets of the shelf, and register the bundle as the challenger.

    The same data sets, options and code give the same bundle. Nothing is released: the gate holds the challenger
    against the champion.

    Example: roadgrip-train retrain --data winter --data 0123456789abcdef --experiment winter
    """
    # Trees and mixtures take seconds to import: they are where they are needed.
    from training.data.data_shelf import training_sets
    from training.retraining.retrain import TABLE_VERSIONS, RetrainOptions, retrained

    laboratory = Laboratory(lab)
    options = RetrainOptions(
        tables=tuple(tables or TABLE_VERSIONS),
        seed=seed,
        name=name,
        trees_count=trees,
        depth_count=depth,
        local_sections=tuple(local or ()),
    )
    with progress_bar() as bar:
        done = retrained(
            laboratory,
            training_sets(laboratory, data),
            options,
            experiment=experiment,
            show=shown_on(bar),
            tools=tools_provenance(),
            reason=reason,
            address=tracking,
            out=out,
        )
    if as_json:
        typer.echo(json.dumps(_document(done)))
    else:
        _print(done, lab=lab, out=out)


def ui(
    *,
    lab: Lab = DEFAULT_FOLDER,
    tracking: Tracking = None,
    port: Annotated[int, typer.Option(min=1, max=65535, help="On 127.0.0.1.")] = DEFAULT_PORT,
) -> None:
    """Open mlflow's own pages on the laboratory's records, for this machine alone; Ctrl-C ends it.

    Example: roadgrip-train ui --lab lab
    """
    from training.tracking import FILES_FOLDER_NAME, server_command, server_environment

    address = address_of(Laboratory(lab), tracking)
    if address.startswith(("http://", "https://")):
        typer.echo(f"the records are on a server: {shown_address(address)}")
        return
    command = server_command(address, files_folder=lab / FILES_FOLDER_NAME, port=port)
    console.print(f"http://127.0.0.1:{port} shows {shown_address(address)}; Ctrl-C ends it", highlight=False)
    # In a session of its own it does not hear Ctrl-C itself, and is ended in good order.
    with subprocess.Popen(command, env=server_environment(), start_new_session=True) as server:  # noqa: S603 - ours
        code = _ended(server)
    if code:
        raise ConfigurationError(f"mlflow's server ended with code {code}; what it said is above")


@models_app.command(name="list")
def list_models(*, lab: Lab = DEFAULT_FOLDER, tracking: Tracking = None, as_json: AsJson = False) -> None:
    """List the versions of the registered model, the newest first.

    Example: roadgrip-train models list --lab lab
    """
    held = models(Laboratory(lab), address=tracking)
    if as_json:
        typer.echo(json.dumps([_model_document(model) for model in held]))
        return
    if not held:
        typer.echo("nothing is registered; make something with `roadgrip-train retrain`")
        return
    table = Table("version", "bundle", "called", "registered", "said of it", title=MODEL_NAME, title_justify="left")
    for model in held:
        said = ", ".join(f"{name} {value}" for name, value in sorted(model.words.items()))
        table.add_row(str(model.version), model.bundle_id, ", ".join(model.aliases), _moment(model.made_unix_s), said)
    Console().print(table)


@models_app.command()
def show(
    ref: Annotated[str, typer.Argument(help="Alias, number of a version, or id of a bundle.")] = CHALLENGER,
    *,
    lab: Lab = DEFAULT_FOLDER,
    tracking: Tracking = None,
    as_json: AsJson = False,
) -> None:
    """Fetch a registered bundle, check its files, and print its card.

    Example: roadgrip-train models show challenger
    """
    found = registered(Laboratory(lab), ref, address=tracking)
    manifest = manifest_from_json((found.folder / MANIFEST_NAME).read_text(encoding="utf-8"))
    if as_json:
        said = {"version": found.version, "bundle_id": found.bundle_id, "run_id": found.run_id}
        typer.echo(
            json.dumps({**said, "aliases": found.aliases, "folder": str(found.folder), "metrics": manifest.metrics})
        )
        return
    called = f", called {' and '.join(found.aliases)}" if found.aliases else ""
    typer.echo(f"version {found.version}{called}, in {found.folder}\n\n{card_of(manifest)}")


@models_app.command()
def alias(
    name: Annotated[str, typer.Argument(help="Such as challenger, canary, champion.")],
    version: Annotated[int, typer.Argument(min=1, help="Number of a version.")],
    *,
    lab: Lab = DEFAULT_FOLDER,
    tracking: Tracking = None,
) -> None:
    """Let a name point to a version of the registered model. Units are told nothing: that is what promoting is for.

    Example: roadgrip-train models alias challenger 3
    """
    set_alias(Laboratory(lab), name, version, address=tracking)
    typer.echo(f"{name} is version {version} of {MODEL_NAME}")


def _ended(server: subprocess.Popen[bytes]) -> int:
    """Return with what code a server ended; 0 once it was ended from here."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return server.wait()
    except KeyboardInterrupt:
        os.killpg(server.pid, signal.SIGTERM)
        try:
            server.wait(_ENDING_S)
        except subprocess.TimeoutExpired:
            os.killpg(server.pid, signal.SIGKILL)
        return 0
    finally:
        signal.signal(signal.SIGTERM, before)


def _print(done: Retrained, *, lab: Path, out: Path | None) -> None:
    from training.retraining.records import short_figures

    versions = [f"feature table {model.plan.table.version}, %" for model in done.made.models]
    table = Table("mean error", *versions, title="By models that had not seen the drive", title_justify="left")
    for title, errors in short_figures(done.made):
        table.add_row(title, *("-" if error is None else f"{100.0 * error:.2f}" for error in errors))
    Console().print(table)
    typer.echo(f"bundle {done.manifest.name} {done.manifest.bundle_id}" + (f" in {out}" if out else ""))
    typer.echo(f"version {done.version} of {MODEL_NAME}, called {CHALLENGER}")
    typer.echo(f"records at {done.records}, run {done.run_id}; `roadgrip-train ui --lab {lab}` opens them")


def _document(done: Retrained) -> dict[str, object]:
    return {
        "bundle_id": done.manifest.bundle_id,
        "version": done.version,
        "alias": CHALLENGER,
        "run_id": done.run_id,
        "records": done.records,
        "metrics": done.manifest.metrics,
    }


def _model_document(model: RegisteredModel) -> dict[str, object]:
    return {
        "version": model.version,
        "bundle_id": model.bundle_id,
        "run_id": model.run_id,
        "made_unix_s": model.made_unix_s,
        "aliases": list(model.aliases),
        "words": dict(model.words),
    }


def _moment(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, UTC).strftime("%Y-%m-%d %H:%M UTC")
