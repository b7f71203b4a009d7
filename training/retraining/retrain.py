"""Retraining: data sets of the shelf become a bundle, records of how, and a version of the registered model.

The same data sets, options and code give the same bundle, whatever the order in which the data sets are named. The
finished bundle is nobody's yet: it is called the challenger, and the gate holds it against the champion.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from roadgrip.bundle import MANIFEST_NAME, BundleManifest
from roadgrip.features import NEWEST_TABLE, PAPER_TABLE
from roadgrip.ledger import Action
from training.bundle_making import MadeBundle, Show, failed_words, made_bundle
from training.data.data_shelf import DataSet
from training.dataset import DatasetError
from training.fit_parameters import FitParameters
from training.laboratory import Laboratory
from training.retraining.drives import DealtDrives, dealt_drives
from training.retraining.environment import code_version
from training.retraining.records import data_digests, record_bundle, summary
from training.retraining.registry import (
    BUNDLE_FOLDER_NAME,
    BUNDLE_WORD,
    CHALLENGER,
    MODEL_NAME,
    address_of,
    shown_address,
)
from training.table_models import COVERAGE_FRAC, FOLDS_COUNT, TablePlan, best_plan, paper_plan
from training.tracking import FILES_FOLDER_NAME, ModelRegister, Tracker

TABLE_VERSIONS = (NEWEST_TABLE.version, PAPER_TABLE.version)
_ABOUT_MODEL = (
    "Friction of a road by what a vehicle noticed in its curve, and the error to expect of that. A version is the "
    "model of the newest feature table of a bundle; the whole bundle lies with the run that made it, in `bundle/`."
)
_INTENDED_USE = "units on the roads that it learned from, and on ordinary rural roads like them; not released by itself"
_LIMITS = (
    "what is simulated stands for one kind of car on maps as surveyed; what was measured is as good as the instrument "
    "and its position; a car that uses little of the grip there is says little about how much there would be"
)


@dataclass(frozen=True, slots=True)
class RetrainOptions:
    """How to retrain.

    Attributes:
        tables: Versions of the feature tables that get a model.
        seed: Of folds, roads that only judge, and trees.
        name: Of the bundle.
        trees_count: Boosting rounds of the friction models; by default as the study found.
        depth_count: Levels of a tree; by default as the study found.
        local_sections: Sections that get a model of their own, too.
    """

    tables: tuple[int, ...] = TABLE_VERSIONS
    seed: int = FitParameters().seed
    name: str = MODEL_NAME
    trees_count: int | None = None
    depth_count: int | None = None
    local_sections: tuple[str, ...] = ()

    def plans(self) -> tuple[TablePlan, ...]:
        """Return how the model of each table is grown, the newest table first.

        Raises:
            DatasetError: There is no such table.
        """
        known = {
            NEWEST_TABLE.version: best_plan(seed=self.seed),
            PAPER_TABLE.version: paper_plan(FitParameters(seed=self.seed)),
        }
        if unknown := sorted(set(self.tables) - set(known)):
            spoken = " and ".join(map(str, sorted(known)))
            raise DatasetError(f"no model is made for feature table {unknown[0]}; there are {spoken}")
        return tuple(self._grown_otherwise(known[version]) for version in sorted(set(self.tables), reverse=True))

    def words(self) -> list[str]:
        """Return the options that differ from what they are by default, as the command takes them."""
        said: list[tuple[str, object]] = []
        if set(self.tables) != set(TABLE_VERSIONS):
            said += [("--tables", version) for version in sorted(set(self.tables))]
        said += [
            (option, value)
            for option, value in (("--trees", self.trees_count), ("--depth", self.depth_count))
            if value is not None
        ]
        said += [("--local", section) for section in sorted(set(self.local_sections))]
        said += [("--seed", self.seed)] if self.seed != FitParameters().seed else []
        said += [("--name", self.name)] if self.name != MODEL_NAME else []
        return [f"{option} {value}" for option, value in said]

    def _grown_otherwise(self, plan: TablePlan) -> TablePlan:
        given = plan.parameters
        return replace(
            plan,
            parameters=replace(
                given,
                trees_count=self.trees_count or given.trees_count,
                depth_count=self.depth_count or given.depth_count,
            ),
        )


@dataclass(frozen=True, slots=True)
class Retrained:
    """What came of a retraining.

    Attributes:
        made: The bundle.
        version: Its number in the register.
        run_id: Of mlflow's run.
        records: Where mlflow's records are, for people.
    """

    made: MadeBundle
    version: int
    run_id: str
    records: str

    @property
    def manifest(self) -> BundleManifest:
        """The bundle's manifest."""
        return self.made.manifest


def retrained(
    lab: Laboratory,
    data_sets: Sequence[DataSet],
    options: RetrainOptions,
    *,
    experiment: str,
    show: Show,
    tools: Mapping[str, str],
    reason: str = "",
    address: str | None = None,
    out: Path | None = None,
) -> Retrained:
    """Return the bundle that was grown, recorded, registered as the challenger, and written into the ledger.

    Args:
        lab: The laboratory.
        data_sets: What to learn from, from `training.data.data_shelf.training_sets`.
        options: How.
        experiment: Under which name mlflow keeps the run.
        show: Shows progress.
        tools: Versions of the tools that models are made with.
        reason: Why, for the ledger.
        address: Of mlflow's records, if not the laboratory's.
        out: Folder where the bundle is written, too.

    Raises:
        DatasetError: There is too little to learn from.
        ConfigurationError: Nothing can be recorded at the address.
        LedgerError: The ledger cannot be read.
    """
    # Found out now, not after hours of growing trees.
    lab.ledger()
    place = address_of(lab, address)
    drives = dealt_drives(data_sets, table=options.plans()[0].table, seed=options.seed)
    opened = show("opening the records", 1)
    # Files of an experiment that a server keeps are the server's business.
    files_folder = lab.folder / FILES_FOLDER_NAME if place.startswith("sqlite:") else None
    tracker = Tracker(address=place, experiment=experiment, files_folder=files_folder)
    register = ModelRegister(address=place)
    run = tracker.begin(f"retrain {options.name}", parameters=_parameters(options, data_sets, drives))
    opened(1)
    with tempfile.TemporaryDirectory(prefix="roadgrip-retrain-") as temporary:
        folder = Path(temporary)
        try:
            made = bundle_of(data_sets, drives, options, folder / BUNDLE_FOLDER_NAME, show=show, tools=tools)
            recorded = show("recording and registering", 1)
            record_bundle(run, made, data_sets, folder, tools=tools)
            version = register.add(
                MODEL_NAME,
                run_id=run.run_id,
                words={BUNDLE_WORD: made.manifest.bundle_id, **data_digests(data_sets)},
                description=summary(made),
                about_model=_ABOUT_MODEL,
            ).version
            register.set_alias(MODEL_NAME, CHALLENGER, version)
        except BaseException:  # a break by hand ends the run, too
            run.end(well=False)
            raise
        run.end()
        if out is not None:
            _put(folder / BUNDLE_FOLDER_NAME, out)
    lab.record(
        Action.RETRAINED,
        made.manifest.bundle_id,
        reason=reason or f"retrained on {', '.join(sorted(data_set.card.name for data_set in data_sets))}",
        evidence={
            "mlflow_run": run.run_id,
            "version": str(version),
            "experiment": experiment,
            **data_digests(data_sets),
            **code_version(),
        },
    )
    recorded(1)
    return Retrained(made, version, run.run_id, shown_address(place))


def bundle_of(
    data_sets: Sequence[DataSet],
    drives: DealtDrives,
    options: RetrainOptions,
    folder: Path,
    *,
    show: Show,
    tools: Mapping[str, str],
) -> MadeBundle:
    """Return the bundle that was grown from data sets, judged and written, and nothing else.

    Args:
        data_sets: Where the drives come from.
        drives: The drives, from `training.retraining.drives.dealt_drives`.
        options: How.
        folder: Of the bundle.
        show: Shows progress.
        tools: Versions of the tools that models are made with.

    Raises:
        DatasetError: A section has too few drives for a model of its own.
    """
    return made_bundle(
        drives.learned,
        options.plans(),
        folder,
        name=options.name,
        fresh=drives.fresh,
        unseen=drives.unseen,
        provenance={**_provenance(options, data_sets, drives), **tools},
        show=show,
        local_sections=sorted(set(options.local_sections)),
        with_references=True,
    )


def _put(bundle: Path, out: Path) -> None:
    """Copy a bundle into a folder, in place of one that is there."""
    if (out / MANIFEST_NAME).exists():
        # A model that the new bundle does not name would make it one that no unit loads.
        for old in out.glob("*.onnx"):
            old.unlink()
    shutil.copytree(bundle, out, dirs_exist_ok=True)


def _parameters(
    options: RetrainOptions, data_sets: Sequence[DataSet], drives: DealtDrives
) -> dict[str, str | int | float]:
    """Return what a retraining runs with, for the records."""
    plans = options.plans()
    grown = {
        f"{plan.version}.{name}": str(value)
        for plan in plans
        for name, value in {**asdict(plan.parameters), "features_count": len(plan.features)}.items()
    }
    return {
        "name": options.name,
        "seed": options.seed,
        "tables": " ".join(plan.version for plan in plans),
        "local": " ".join(sorted(set(options.local_sections))),
        "folds_count": FOLDS_COUNT,
        "coverage_frac": COVERAGE_FRAC,
        "learned_count": len(drives.learned.runs),
        "fresh_count": len(drives.unseen),
        "repeated_count": drives.repeated_count,
        "weighted": str(drives.learned.weight_ratio is not None),
        **grown,
        **data_digests(data_sets),
        **code_version(),
    }


def _provenance(options: RetrainOptions, data_sets: Sequence[DataSet], drives: DealtDrives) -> dict[str, str]:
    ordered = sorted(data_sets, key=lambda data_set: data_set.card.digest)
    told = ", ".join(
        f"{data_set.card.name} ({data_set.card.kind}, {data_set.card.usable_count} drives)" for data_set in ordered
    )
    words = ["roadgrip-train retrain", *(f"--data {data_set.card.digest}" for data_set in ordered), *options.words()]
    return {
        "command": " ".join(words),
        "intended_use": _INTENDED_USE,
        "limits": _LIMITS,
        "learned_from": f"{len(drives.learned.runs)} drives of {told}",
        "failed": failed_words(drives.runs),
        "judged_on": (
            "drives on known and own roads by regressors that had not seen the drive, on random roads by such that had "
            "not seen the road, on own roads by such that had not seen the road either; "
            f"{len(set(drives.unseen.section_id))} fresh roads by the finished models"
        ),
        "dataset_digest": drives.runs.digest(),
        **data_digests(data_sets),
        **code_version(),
    }
