"""A fitted regressor on disk between `roadgrip-train fit` and `roadgrip-train bundle`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import xgboost

from roadgrip.features import FeatureTable, table_of
from training.dataset import DatasetError, Runs
from training.fit_parameters import FitParameters, Target
from training.regressor import Fitted, split_rows

_TREES_NAME = "trees.ubj"
_RECORD_NAME = "fit.json"


def write_fit(fitted: Fitted, folder: Path, *, runs: Runs, parameters: FitParameters) -> None:
    """Write the trees, and beside them how they came about.

    Args:
        fitted: The regressor.
        folder: Made if missing.
        runs: What it was fitted to; its digest is kept, so that nobody bundles it with other data.
        parameters: How it was fitted.
    """
    folder.mkdir(parents=True, exist_ok=True)
    fitted.booster.save_model(folder / _TREES_NAME)
    record = {
        "dataset_digest": runs.digest(),
        "table_digest": runs.table.digest,
        "parameters": asdict(parameters),
        "metrics": fitted.metrics,
    }
    (folder / _RECORD_NAME).write_text(json.dumps(record, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def read_trees(folder: Path) -> xgboost.Booster:
    """Return the trees that `write_fit` left in a folder.

    Raises:
        DatasetError: There are none.
    """
    path = folder / _TREES_NAME
    if not path.is_file():
        raise DatasetError(f"no fitted trees at {path}; make some with `roadgrip-train fit`")
    try:
        return xgboost.Booster(model_file=path)
    except xgboost.core.XGBoostError as error:
        raise DatasetError(f"{path} holds no trees") from error


def fitted_table(folder: Path) -> FeatureTable:
    """Return the feature table that the regressor in a folder was fitted to.

    Raises:
        DatasetError: Nothing was fitted there.
        FeatureTableError: It was fitted to a table that is not spoken here.
    """
    path = folder / _RECORD_NAME
    try:
        digest = str(json.loads(path.read_text(encoding="utf-8"))["table_digest"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{path} does not say how the trees were fitted: {error}") from error
    return table_of(digest, subject=str(path))


def read_fit(folder: Path, *, runs: Runs) -> tuple[Fitted, FitParameters]:
    """Return a fitted regressor with the split it was judged by, and how it was fitted.

    Args:
        folder: What `write_fit` wrote.
        runs: The runs it was fitted to.

    Raises:
        DatasetError: Nothing was fitted there, or it was fitted to other runs.
    """
    trees = read_trees(folder)
    try:
        record = json.loads((folder / _RECORD_NAME).read_text(encoding="utf-8"))
        given = record["parameters"]
        parameters = FitParameters(**{**given, "target": Target(given["target"])})
        fitted_to, metrics = str(record["dataset_digest"]), dict(record["metrics"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{folder / _RECORD_NAME} does not say how the trees were fitted: {error}") from error
    if fitted_to != runs.digest():
        raise DatasetError(f"the trees in {folder} were fitted to data set {fitted_to}, not to {runs.digest()}")
    train_rows, test_rows = split_rows(runs, seed=parameters.seed)
    return Fitted(booster=trees, train_rows=train_rows, test_rows=test_rows, metrics=metrics), parameters
