"""Whether every exported model answers as the trees it was made from: on real rows, edges, splits, and with gaps.

Which columns the trees were grown on, their own file says (`training.retraining.tree_files`), not the export: a wrong
choice of columns is an error like any other.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import xgboost

from roadgrip.bundle import ModelManifest
from roadgrip.features import TABLES, FeatureTable
from roadgrip.units import FloatArray
from training.dataset import DatasetError, Runs
from training.export import onnx_estimate_mu, parity_rows
from training.gate.contender import Contender
from training.gate.thresholds import ParityThresholds
from training.gate.verdict import Check, Found, check_of
from training.regressor import estimate_mu
from training.retraining.tree_files import read_tree_file

_NAN_SHARE = 0.2
_SPLITS_SHARE = 0.1
_GAPS_FRAC = 0.1
"""Share of the cells that are missing, in a third of the rows with gaps."""


def onnx_parity(
    contender: Contender, holdouts: Mapping[str, Runs], limits: ParityThresholds, *, rng: np.random.Generator
) -> Found:
    """Return whether every model of a bundle answers as its trees do.

    Args:
        contender: The bundle.
        holdouts: Real drives by role.
        limits: What is asked.
        rng: Source of chance.
    """
    return Found(
        tuple(
            _of_file(contender, model, name, holdouts, limits, rng=rng)
            for model in contender.manifest.models
            for name in model.files
        )
    )


def rows_to_compare(
    real_rows: FloatArray,
    trees: xgboost.Booster,
    columns: Sequence[int],
    *,
    count: int,
    table: FeatureTable,
    rng: np.random.Generator,
) -> FloatArray:
    """Return at least so many rows to ask trees and export about.

    Rows as `training.export.parity_rows` makes them, of real rows, mixtures and edges; real rows with one value on a
    split of the trees or next to it, where rounding decides; and real rows with gaps: single features, a tenth of
    all cells, nothing but gaps.

    Args:
        real_rows: Finite ones. (n, columns of the table)
        trees: What was exported.
        columns: Where the trees' columns stand in a row.
        count: At least so many.
        table: Of the rows.
        rng: Source of chance.
    """
    gaps = _rows_with_gaps(real_rows, round(_NAN_SHARE * count), rng=rng)
    splits = _rows_on_splits(real_rows, trees, columns, round(_SPLITS_SHARE * count), rng=rng)
    parts, missing_count = [gaps, splits], count - len(gaps) - len(splits)
    while missing_count > 0:
        parts.append(parity_rows(real_rows, rng=rng, table=table))
        missing_count -= len(parts[-1])
    return np.vstack(parts)


def difference_mu(trees: xgboost.Booster, model: bytes, rows: FloatArray, columns: Sequence[int]) -> float:
    """Return the largest difference between trees and export; infinite if one gives a number where the other has none.

    Args:
        trees: What was exported.
        model: The export.
        rows: What both are asked. (n, columns of the table)
        columns: Where the trees' columns stand in a row.
    """
    ours, theirs = estimate_mu(trees, rows[:, list(columns)]), onnx_estimate_mu(model, rows)
    if not np.array_equal(np.isnan(ours), np.isnan(theirs)):
        return float("inf")
    both = ~np.isnan(ours)
    return float(np.abs(ours[both] - theirs[both]).max(initial=0.0))


def _of_file(
    contender: Contender,
    model: ModelManifest,
    name: str,
    holdouts: Mapping[str, Runs],
    limits: ParityThresholds,
    *,
    rng: np.random.Generator,
) -> Check:
    def impossible(why: str) -> Check:
        sentence = f"not possible: {why}"
        return check_of("onnx_parity", name, passed=False, required=limits.required, sentence=sentence)

    if contender.trees_folder is None:
        return impossible("the trees that were exported are not known")
    path = contender.trees_folder / f"{Path(name).stem}.json"
    if not path.is_file():
        return impossible(f"there is no {path.name} in the folder of trees")
    try:
        told = read_tree_file(path)
    except DatasetError as error:
        return impossible(str(error))
    trees, table, content = told.trees, TABLES[model.table_digest], contender.bundle.files[name]
    columns = table.columns(told.column_names or table.names).tolist()
    if len(columns) != trees.num_features():
        return impossible(f"the trees were grown on {trees.num_features()} columns, their file names {len(columns)}")
    real = _real_rows(holdouts, table)
    if real is None:
        return impossible("no hold-out has the columns of its feature table")
    rows = rows_to_compare(real, trees, columns, count=limits.rows_count, table=table, rng=rng)
    found = difference_mu(trees, content, rows, columns)
    gaps_count = int(np.isnan(rows).any(axis=1).sum())
    how = f"differs by at most {found:.1e}" if np.isfinite(found) else "has a number where the other has none"
    return check_of(
        "onnx_parity",
        name,
        passed=len(rows) >= limits.rows_count and found <= limits.tolerance_mu,
        required=limits.required,
        figures={"difference_mu": found, "rows_count": len(rows), "rows_with_gaps_count": gaps_count},
        limits={"difference_mu": limits.tolerance_mu, "rows_count": limits.rows_count},
        sentence=f"on {len(rows)} rows, {gaps_count} of them with gaps, the export {how} "
        f"({limits.tolerance_mu:g} at most)",
    )


def _real_rows(holdouts: Mapping[str, Runs], table: FeatureTable) -> FloatArray | None:
    told = [runs.for_table(table) for runs in holdouts.values() if runs.table.covers(table)]
    rows = [runs.features[runs.usable] for runs in told if runs.usable.any()]
    return np.vstack(rows) if rows else None


def _rows_with_gaps(real_rows: FloatArray, count: int, *, rng: np.random.Generator) -> FloatArray:
    rows = real_rows[rng.integers(0, len(real_rows), count)].copy()
    third, width = count // 3, rows.shape[1]
    rows[:third][rng.random((third, width)) < _GAPS_FRAC] = np.nan
    # Every feature alone at least once, if there is room.
    alone = np.arange(third, count)
    rows[alone, alone % width] = np.nan
    rows[:1] = np.nan
    return rows


def _rows_on_splits(
    real_rows: FloatArray, trees: xgboost.Booster, columns: Sequence[int], count: int, *, rng: np.random.Generator
) -> FloatArray:
    splits = sorted({split for tree in trees.get_dump(dump_format="json") for split in _splits(json.loads(tree))})
    if not splits:
        return real_rows[:0]
    rows = real_rows[rng.integers(0, len(real_rows), count)].copy()
    for row, number in zip(rows, rng.integers(0, len(splits), count).tolist(), strict=True):
        column, value = splits[number]
        here = np.float32(value)
        beside = np.nextafter(here, np.float32(rng.choice([-np.inf, np.inf])))
        row[columns[column]] = here if rng.random() < 0.5 else beside
    return rows


def _splits(node: Mapping[str, object]) -> Iterator[tuple[int, float]]:
    children = node.get("children")
    if isinstance(children, list):
        name, value = str(node["split"]), node["split_condition"]
        yield int(name.removeprefix("f")), float(str(value))
        for child in children:
            yield from _splits(child)
