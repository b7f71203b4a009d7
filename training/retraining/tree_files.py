"""The trees that a bundle was exported from, in files of their own: whoever doubts the export can ask them.

They are xgboost's JSON, under the names of the bundle's files: `friction-v2.json` beside `friction-v2.onnx`. What the
trees add up to is an attribute within (`training.regressor.target_of`), and so are the columns that they were grown on.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import xgboost

from training.bundle_making import MadeBundle
from training.dataset import DatasetError

_COLUMNS_ATTRIBUTE = "column_names"


@dataclass(frozen=True, slots=True)
class TreeFile:
    """Trees with what has to be known to ask them.

    Attributes:
        trees: For `training.regressor.estimate_mu`.
        column_names: The features they were grown on, in their order; None for all of their table's.
    """

    trees: xgboost.Booster
    column_names: tuple[str, ...] | None


def write_trees(made: MadeBundle, folder: Path) -> None:
    """Write the trees of all models of a bundle into a folder, made if missing."""
    folder.mkdir(parents=True, exist_ok=True)
    named = [(model, "") for model in made.models]
    named += [(local.model, f"-{local.section_id}") for local in made.local]
    for model, suffix in named:
        for kind, trees in (("friction", model.friction), ("error", model.error)):
            kept = trees.copy()
            if model.plan.column_names is not None:
                kept.set_attr(**{_COLUMNS_ATTRIBUTE: json.dumps(model.plan.column_names)})
            kept.save_model(folder / f"{kind}-{model.plan.version}{suffix}.json")


def read_tree_file(path: Path) -> TreeFile:
    """Return the trees of a file that `write_trees` wrote.

    Raises:
        DatasetError: It holds none.
    """
    try:
        trees = xgboost.Booster(model_file=path)
        told = trees.attr(_COLUMNS_ATTRIBUTE)
        return TreeFile(trees, None if told is None else tuple(str(name) for name in json.loads(told)))
    except (xgboost.core.XGBoostError, ValueError, TypeError) as error:
        raise DatasetError(f"{path} holds no trees: {str(error).splitlines()[0]}") from error
