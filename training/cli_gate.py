"""`roadgrip-train gate`: may a new bundle take the place of the one that units run?"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from roadgrip.errors import ConfigurationError
from roadgrip.ledger import Action
from roadgrip.units import FloatArray
from training.cli_designs import AsJson, progress_bar
from training.data.data_shelf import data_cards, read_data_set
from training.dataset import Runs, joined, read_runs
from training.gate.thresholds import MEASURED_ROLE, ROLES, default_thresholds, read_thresholds
from training.laboratory import DEFAULT_FOLDER, LAB_VARIABLE, Laboratory

# Trees and ONNX take seconds to import: they are where they are needed.
if TYPE_CHECKING:
    from training.gate.contender import Contender
    from training.gate.verdict import Check, Verdict

VERDICT_NAME, PAGE_NAME = "verdict.json", "verdict.html"
DEFAULT_SEED = 0


def gate(
    *,
    challenger: Annotated[str, typer.Option("--challenger", metavar="REF", help="Bundle that wants the place.")],
    champion: Annotated[
        str | None,
        typer.Option("--champion", metavar="REF", help="Bundle that has it; without, limits are absolute."),
    ] = None,
    lab: Annotated[
        Path, typer.Option("--lab", metavar="FOLDER", envvar=LAB_VARIABLE, help="The laboratory.")
    ] = DEFAULT_FOLDER,
    holdout: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROLE=PATH",
            help=f"Runs that judge; repeatable. Roles: {', '.join(ROLES)}.",
            show_default="the hold-outs on the laboratory's shelf",
        ),
    ] = None,
    trees: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="The challenger's trees, for ONNX parity.",
            show_default="a folder trees in the bundle's or beside it",
        ),
    ] = None,
    thresholds: Annotated[
        Path | None, typer.Option(metavar="FILE", help="What is asked, as TOML.", show_default="the packaged file")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FOLDER", help=f"Write {VERDICT_NAME} and {PAGE_NAME} here, too.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of what is drawn.")] = DEFAULT_SEED,
    as_json: AsJson = False,
) -> None:
    """Judge a challenger against the champion on drives that neither learned from.

    The verdict is kept in the laboratory by its digest, with a page, and stands in the ledger. Exit code 0: passed,
    1: not passed, 2: it could not be judged.

    Example: roadgrip-train gate --challenger build/new --champion build/old --out build/verdict
    """
    asked = default_thresholds() if thresholds is None else read_thresholds(thresholds)
    laboratory = Laboratory(lab)
    runs, label_sd_mu = _given(holdout) if holdout else _shelved(laboratory)
    contenders = (
        resolve(laboratory, challenger, trees=trees),
        None if champion is None else resolve(laboratory, champion),
    )
    from training.gate.judge import judge

    with progress_bar() as bar:
        task = bar.add_task("judging", total=None, rate="")
        verdict = judge(
            *contenders,
            runs,
            asked,
            rng=np.random.default_rng(seed),
            made_unix_s=round(time.time(), 3),
            label_sd_mu=label_sd_mu,
            on_step=lambda what, done, total: bar.update(task, description=what, completed=done, total=total),
        )
        bar.update(task, description="judged", completed=1, total=1)
    folder = keep_verdict(laboratory, verdict, out=out)
    attach_verdict(laboratory, verdict, folder)
    if as_json:
        typer.echo((folder / VERDICT_NAME).read_text(encoding="utf-8"), nl=False)
    else:
        _print(verdict, folder)
    if not verdict.passed:
        raise typer.Exit(1)


def resolve(lab: Laboratory, ref: str, *, trees: Path | None = None) -> Contender:
    """Return the bundle that a reference names: the path of its folder, or what the register knows it by.

    Args:
        lab: Where names are looked up.
        ref: A path, or an alias, a version or a bundle's id.
        trees: Where its trees lie; by default a folder in the bundle's or beside it.

    Raises:
        BundleError: It must not be trusted.
        ConfigurationError: There is no such folder, and the register knows nothing of that name.
    """
    from training.gate.contender import read_contender

    if trees is not None and not trees.is_dir():
        raise ConfigurationError(f"there are no trees in {trees}: it is no folder")
    if Path(ref).is_dir():
        return read_contender(Path(ref), trees_folder=trees)
    from training.retraining.registry import registered

    if not _has_register(lab):
        raise ConfigurationError(f"there is no bundle in a folder {ref}, and no register of models in {lab.folder}")
    found = registered(lab, ref)
    return read_contender(found.folder, trees_folder=trees or found.trees_folder)


def keep_verdict(lab: Laboratory, verdict: Verdict, *, out: Path | None = None) -> Path:
    """Return the folder that holds the verdict and its page, by its digest; the act stands in the ledger.

    Args:
        lab: The laboratory.
        verdict: What was said.
        out: A second folder for the same files; made if missing.
    """
    from training.gate.page import page_of
    from training.gate.verdict import verdict_digest, verdict_to_json

    digest = verdict_digest(verdict)
    folder = lab.verdicts_folder / digest
    documents = {VERDICT_NAME: verdict_to_json(verdict), PAGE_NAME: page_of(verdict)}
    for place in (folder, *([] if out is None else [out])):
        place.mkdir(parents=True, exist_ok=True)
        for name, text in documents.items():
            _write_whole(place / name, text)
    failures = ", ".join(dict.fromkeys(check.name for check in verdict.failures))
    champion = "without a champion" if verdict.champion is None else f"against {verdict.champion}"
    lab.record(
        Action.JUDGED,
        verdict.challenger,
        reason=f"passed the gate {champion}" if verdict.passed else f"did not pass the gate {champion}: {failures}",
        evidence={"verdict": digest, "passed": "true" if verdict.passed else "false"},
        now_unix_s=verdict.made_unix_s,
    )
    return folder


def attach_verdict(lab: Laboratory, verdict: Verdict, folder: Path) -> None:
    """Keep the verdict and its page with the run that made the challenger, if the register knows it.

    Args:
        lab: Whose register.
        verdict: What was said.
        folder: Where it lies.
    """
    if not _has_register(lab):
        return
    from training.gate.verdict import verdict_digest
    from training.retraining.registry import attach, models

    words = {"gate": "passed" if verdict.passed else "not passed", "gate.verdict": verdict_digest(verdict)}
    for model in models(lab):
        if model.bundle_id == verdict.challenger:
            attach(lab, model.version, [folder / VERDICT_NAME, folder / PAGE_NAME], words)


def _has_register(lab: Laboratory) -> bool:
    """Return whether there is a register of models; looking into one that is not would make it."""
    from training.retraining.registry import ADDRESS_VARIABLE
    from training.tracking import DATABASE_FILE_NAME

    return ADDRESS_VARIABLE in os.environ or (lab.folder / DATABASE_FILE_NAME).exists()


def _write_whole(path: Path, text: str) -> None:
    partial = path.with_name(f"{path.name}.partial")
    with partial.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)


def _given(words: Sequence[str]) -> tuple[dict[str, Runs], FloatArray | None]:
    """Return the hold-outs that were named on the command line, those of one role as one."""
    parts: dict[str, list[Runs]] = {}
    for word in words:
        role, equals, place = word.partition("=")
        if not equals or role not in ROLES:
            raise typer.BadParameter(f"{word} is not ROLE=PATH with one of {', '.join(ROLES)}", param_hint="--holdout")
        parts.setdefault(role, []).append(read_runs(Path(place)))
    return {role: joined(runs) for role, runs in parts.items()}, None


def _shelved(lab: Laboratory) -> tuple[dict[str, Runs], FloatArray | None]:
    """Return the hold-outs of the laboratory's shelf, and how uncertain the measured labels are."""
    parts: dict[str, list[Runs]] = {}
    uncertain: list[FloatArray] = []
    for card in data_cards(lab):
        if card.role in ROLES:
            data_set = read_data_set(lab, card.digest)
            parts.setdefault(card.role.value, []).append(data_set.runs)
            if card.role == MEASURED_ROLE:
                sds = data_set.label_sd_mu
                uncertain.append(np.full(len(data_set.runs), np.nan) if sds is None else sds)
    if not parts:
        raise ConfigurationError(f"no hold-out lies on the shelf of {lab.folder}; give some with --holdout")
    runs: Mapping[str, Runs] = {role: joined(given) for role, given in parts.items()}
    return dict(runs), np.concatenate(uncertain) if uncertain else None


def _print(verdict: Verdict, folder: Path) -> None:
    from training.gate.verdict import in_order

    than = "no champion" if verdict.champion is None else f"champion {verdict.champion}"
    table = Table("", "check", "of what", "what was found", title=f"Challenger {verdict.challenger}, {than}")
    for check in in_order(verdict.checks):
        table.add_row(_mark(check), check.name, check.subject, Text(check.sentence))
    Console().print(table)
    word = "passed" if verdict.passed else f"did not pass: {len(verdict.failures)} of its checks failed"
    typer.echo(f"{verdict.challenger} {word}; {folder / PAGE_NAME}")


def _mark(check: Check) -> Text:
    if check.failed:
        return Text("FAILED", style="red")
    if not check.required:
        return Text("informs" if check.passed else "informs, not good", style="dim")
    return Text("passed", style="green")
