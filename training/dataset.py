"""Drives with known friction as a table: one row per run, features and label, in Parquet.

Runs that gave no summary (the car left the road, the onboard client refused the trace) stay in the table with their
outcome and NaN features: a data set that forgets its failures looks better than the road.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from roadgrip.errors import FeatureTableError, RoadgripError
from roadgrip.features import NEWEST_TABLE, FeatureTable, table_of
from roadgrip.units import FloatArray

COMPLETED = "completed"
_METADATA_KEY = b"roadgrip"

SHARDS_FOLDER_NAME = "shards"
"""Where a design's files lie while it is driven."""
RUNS_FILE_NAME = "runs.parquet"
"""The whole data set of a finished design, in the design's folder."""

LABEL_COLUMNS = (
    "label_mu",
    "lowest_mu",
    "base_friction_mu",
    "wear_ratio",
    "attempt_number",
    "rated_speed_mps",
    "target_speed_mps",
    "mean_speed_mps",
    "duration_s",
    "friction_guess_mu",
    "abs_active_frac",
    "tcs_active_frac",
    "esc_active_frac",
    "peak_utilisation_ratio",
    "peak_sideslip_rad",
)
"""What is known about a run beyond its features, as numbers; docs/designs.md says what each means.

None of them is for a regressor to learn from, the driver's guess least of all: a vehicle on the road knows none.
"""

_WORD_COLUMNS = ("run_key", "scenario", "section_id", "outcome")


class DatasetError(RoadgripError):
    """A table of runs that cannot be used; the message says why."""


@dataclass(frozen=True, slots=True)
class Runs:
    """Simulated or measured runs, one row each.

    Attributes:
        features: In the order of the feature table; NaN in rows without a summary. (n, columns)
        labels: One array per name of `LABEL_COLUMNS`. Each (n,)
        scenario: The scenario of each run. (n,)
        section_id: The section it was driven on. (n,)
        outcome: "completed", or why there is no summary. (n,)
        run_key: Name of each run inside its design; the run's seed follows from it. (n,)
        table: The feature table.
    """

    features: FloatArray
    labels: dict[str, FloatArray]
    scenario: tuple[str, ...]
    section_id: tuple[str, ...]
    outcome: tuple[str, ...]
    run_key: tuple[str, ...]
    table: FeatureTable = NEWEST_TABLE

    def __post_init__(self) -> None:
        if self.features.ndim != 2 or self.features.shape[1] != len(self.table):
            message = f"features of shape {self.features.shape} are not rows of {len(self.table)}"
            raise DatasetError(message)

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.features)

    @property
    def usable(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which rows have a summary and a label: a mask of shape (n,)."""
        completed = np.array([outcome == COMPLETED for outcome in self.outcome], dtype=bool)
        return completed & np.isfinite(self.features).all(axis=1) & np.isfinite(self.labels["label_mu"])

    def columns(self, names: Sequence[str]) -> FloatArray:
        """Return some features of every run, in the order of the names. (n, names)

        Raises:
            FeatureTableError: The table has no feature of such a name.
        """
        return self.features[:, self.table.columns(names)]

    def for_table(self, table: FeatureTable) -> Runs:
        """Return the same runs with the features of another table, for a model that serves it.

        Raises:
            FeatureTableError: The runs' own table lacks one of them.
        """
        if table == self.table:
            return self
        return replace(self, features=self.features[:, self.table.columns_of(table)], table=table)

    def rows(self, indices: np.ndarray[tuple[int], np.dtype[np.intp]]) -> Runs:
        """Return some of the runs, in the order of the indices."""
        chosen = indices.tolist()
        return replace(
            self,
            features=self.features[indices],
            labels={name: values[indices] for name, values in self.labels.items()},
            scenario=tuple(self.scenario[i] for i in chosen),
            section_id=tuple(self.section_id[i] for i in chosen),
            outcome=tuple(self.outcome[i] for i in chosen),
            run_key=tuple(self.run_key[i] for i in chosen),
        )

    def digest(self) -> str:
        """Return sixteen hexadecimal characters that name the content, whatever the order of the rows."""
        order = np.argsort(np.array(self.run_key))
        digest = hashlib.sha256(self.table.digest.encode())
        digest.update(
            "\n".join(
                f"{self.run_key[i]}|{self.scenario[i]}|{self.section_id[i]}|{self.outcome[i]}" for i in order
            ).encode()
        )
        digest.update(self.features[order].astype("<f4").tobytes())
        for name in LABEL_COLUMNS:
            digest.update(self.labels[name][order].astype("<f8").tobytes())
        return digest.hexdigest()[:16]


def write_runs(runs: Runs, path: Path, *, description: dict[str, str]) -> None:
    """Write the runs as one Parquet file, whole or not at all.

    Args:
        runs: The rows.
        path: The file; its folder must exist.
        description: Where the rows come from, kept in the file's metadata beside the feature table's digest.
    """
    columns: dict[str, object] = {name: list(getattr(runs, name)) for name in _WORD_COLUMNS}
    columns |= {name: runs.labels[name] for name in LABEL_COLUMNS}
    columns |= {name: runs.features[:, i].astype(np.float32) for i, name in enumerate(runs.table.names)}
    table = pa.table(columns).replace_schema_metadata(metadata_of(description, table=runs.table))
    partial = path.with_suffix(".partial")
    pq.write_table(table, partial, compression="zstd")
    partial.replace(path)


def read_runs(source: Path) -> Runs:
    """Return the runs of one Parquet file, of a finished design's folder, or of all files of a folder by their names.

    Raises:
        DatasetError: There is no such file, or it is no table of runs.
        FeatureTableError: It was made for a feature table that is not spoken here, or its files for different ones.
    """
    whole = source / RUNS_FILE_NAME
    paths = [whole] if whole.is_file() else sorted(source.glob("*.parquet")) if source.is_dir() else [source]
    if not paths and (source / SHARDS_FOLDER_NAME).is_dir():
        raise DatasetError(f"the design in {source} is not finished; give its `roadgrip-train simulate` again")
    if not paths or not all(path.is_file() for path in paths):
        raise DatasetError(f"no Parquet files at {source}; make some with `roadgrip-train simulate`")
    return joined([_read_one(path) for path in paths])


def read_outcomes(path: Path) -> tuple[str, ...]:
    """Return how the runs of one Parquet file ended, without reading the rest."""
    return tuple(pq.read_table(path, columns=["outcome"])["outcome"].to_pylist())


def metadata_of(description: dict[str, str], *, table: FeatureTable = NEWEST_TABLE) -> dict[bytes, bytes]:
    """Return what a Parquet file says about its origin, as the format wants it; `read_description` reads it back."""
    return {_METADATA_KEY: json.dumps({**description, "table_digest": table.digest}, sort_keys=True).encode()}


def joined(parts: list[Runs]) -> Runs:
    """Return the rows of all parts, one after another.

    Raises:
        FeatureTableError: They were made for different feature tables.
    """
    digests = sorted({part.table.digest for part in parts})
    if len(digests) > 1:
        raise FeatureTableError(f"runs of the feature tables {', '.join(digests)} do not go into one table")
    return Runs(
        features=np.concatenate([part.features for part in parts]),
        labels={name: np.concatenate([part.labels[name] for part in parts]) for name in LABEL_COLUMNS},
        scenario=tuple(s for part in parts for s in part.scenario),
        section_id=tuple(s for part in parts for s in part.section_id),
        outcome=tuple(o for part in parts for o in part.outcome),
        run_key=tuple(k for part in parts for k in part.run_key),
        table=parts[0].table if parts else NEWEST_TABLE,
    )


def read_description(path: Path) -> dict[str, str]:
    """Return what a Parquet file of runs says about its origin.

    Raises:
        DatasetError: The file is no table of runs.
    """
    try:
        metadata = pq.read_schema(path).metadata or {}
        description: dict[str, str] = json.loads(metadata[_METADATA_KEY])
    except (pa.ArrowException, OSError, KeyError, ValueError) as error:
        raise DatasetError(f"{path} is no table of runs: {error}") from error
    return description


def _read_one(path: Path) -> Runs:
    features_table = table_of(read_description(path)["table_digest"], subject=str(path))
    table = pq.read_table(path)
    missing = {*_WORD_COLUMNS, *LABEL_COLUMNS, *features_table.names} - set(table.column_names)
    if missing:
        raise DatasetError(f"{path} lacks the columns {sorted(missing)}")
    return Runs(
        features=np.column_stack([table[name].to_numpy() for name in features_table.names]).astype(np.float64),
        labels={name: table[name].to_numpy().astype(np.float64) for name in LABEL_COLUMNS},
        scenario=tuple(table["scenario"].to_pylist()),
        section_id=tuple(table["section_id"].to_pylist()),
        outcome=tuple(table["outcome"].to_pylist()),
        run_key=tuple(table["run_key"].to_pylist()),
        table=features_table,
    )
