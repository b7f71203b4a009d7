"""A bundle before the gate, and what it says of drives: as a unit would have judged them, row by row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roadgrip.bundle import BundleManifest, ModelManifest
from roadgrip.features import TABLES, FeatureTable
from roadgrip.records import NotCounted
from roadgrip.units import BoolArray, FloatArray
from rsu_app.domain.judgement import Judgement, judgement
from training.dataset import Runs
from training.error_model import LEAST_MU, log_error_ratio
from training.evaluation_bundle import Bundle, read_bundle
from training.export import onnx_estimate_mu
from training.regressor import RowIndices

TREES_FOLDER_NAME = "trees"


@dataclass(frozen=True, slots=True)
class Contender:
    """A bundle before the gate.

    Attributes:
        bundle: Its manifest and files, checked as a unit checks them.
        trees_folder: Where the trees lie that its models were exported from; None where they are not known.
    """

    bundle: Bundle
    trees_folder: Path | None = None

    @property
    def manifest(self) -> BundleManifest:
        """What the bundle says about itself."""
        return self.bundle.manifest

    @property
    def tables(self) -> tuple[FeatureTable, ...]:
        """The feature tables it serves, newest first."""
        return tuple(table for digest, table in tuple(TABLES.items())[::-1] if digest in self.manifest.table_digests)

    @property
    def size_bytes(self) -> int:
        """All of its files but the manifest."""
        return sum(map(len, self.bundle.files.values()))


@dataclass(frozen=True, slots=True, eq=False)
class Answers:
    """What a bundle says of drives. Each (n,)

    Attributes:
        mu: Friction; NaN where there is no answer.
        expected_error_ratio: Magnitude of the error to expect; NaN without a model for it.
        mu_low: Below this the friction hardly is; NaN without an expected error.
        mu_high: Above this the friction hardly is; NaN without an expected error.
        at_least: The passage only says that the friction is at least `mu_low`.
        strange: Outside of what the model was made for.
        unbelievable: No answer, or one that a unit would not believe.
        promised_frac: How often the bounds shall hold; NaN where there are none.
    """

    mu: FloatArray
    expected_error_ratio: FloatArray
    mu_low: FloatArray
    mu_high: FloatArray
    at_least: BoolArray
    strange: BoolArray
    unbelievable: BoolArray
    promised_frac: FloatArray

    @property
    def counted(self) -> BoolArray:
        """Which would move the interval of a unit. (n,)"""
        return ~self.strange & ~self.unbelievable


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A hold-out in the columns of one feature table, and what both bundles say of it.

    Attributes:
        role: What the hold-out is for.
        runs: Its usable rows.
        challenger: What the challenger says.
        champion: What the champion says; None without one that serves such vehicles.
        label_sd_mu: Standard deviation of each label; None where labels are exact. (n,)
    """

    role: str
    runs: Runs
    challenger: Answers
    champion: Answers | None
    label_sd_mu: FloatArray | None = None

    @property
    def title(self) -> str:
        """For people."""
        return f"{self.role.replace('_', ' ')}, feature table {self.runs.table.version}"

    @property
    def label_mu(self) -> FloatArray:
        """The truth. (n,)"""
        return self.runs.labels["label_mu"]

    def error_ratio(self, answers: Answers) -> FloatArray:
        """Return how far estimates are off, on the logarithm; no estimate is as bad as the least friction. (n,)"""
        return log_error_ratio(np.where(np.isfinite(answers.mu), answers.mu, LEAST_MU), self.label_mu)


def read_contender(folder: Path, *, trees_folder: Path | None = None) -> Contender:
    """Return the bundle of a folder after what a unit checks.

    Args:
        folder: The bundle's.
        trees_folder: Where its trees lie; by default a folder of that name in the bundle's or beside it, if there.

    Raises:
        BundleError: It must not be trusted; the message says why.
        FeatureTableError: It was made for a feature table that this software does not speak.
    """
    if trees_folder is None:
        places = (folder / TREES_FOLDER_NAME, folder.parent / TREES_FOLDER_NAME)
        trees_folder = next((place for place in places if place.is_dir()), None)
    return Contender(read_bundle(folder), trees_folder)


def table_served(contender: Contender, table: FeatureTable) -> FeatureTable | None:
    """Return the newest table of a bundle that a summary of a table can be told in; None without one."""
    return next((served for served in contender.tables if table.covers(served)), None)


def answers_of(contender: Contender, runs: Runs) -> Answers | None:
    """Return what a bundle says of drives, told in the newest of its tables that they can be told in; None without one.

    Each section is judged by its own model if the bundle has one.

    Args:
        contender: The bundle.
        runs: Drives with a summary.
    """
    table = table_served(contender, runs.table)
    if table is None:
        return None
    told = runs.for_table(table)
    columns = np.full((len(told), 5), np.nan)
    words = np.zeros((len(told), 3), dtype=np.bool_)
    for model, rows in _by_model(contender, table, told.section_id):
        for place, said in zip(rows.tolist(), _judgements(contender.bundle, model, told.features[rows]), strict=True):
            columns[place] = _figures(said, model)
            words[place] = (
                said.at_least,
                bool(said.flags & NotCounted.OUT_OF_ENVELOPE),
                said.mu is None or bool(said.flags & NotCounted.ESTIMATE_OUT_OF_RANGE),
            )
    mu, expected, mu_low, mu_high, promised = columns.T
    at_least, strange, unbelievable = words.T
    return Answers(
        mu=mu,
        expected_error_ratio=expected,
        mu_low=mu_low,
        mu_high=mu_high,
        at_least=at_least,
        strange=strange,
        unbelievable=unbelievable,
        promised_frac=promised,
    )


def mu_of_rows(contender: Contender, rows: FloatArray, section_id: Sequence[str], *, table: FeatureTable) -> FloatArray:
    """Return the friction that a bundle answers for rows, whatever it thinks of them. (n,)

    Args:
        contender: A bundle that serves the table.
        rows: Features. (n, columns of the table)
        section_id: Where each was driven. (n,)
        table: Of the rows.
    """
    mu = np.full(len(rows), np.nan)
    for model, places in _by_model(contender, table, section_id):
        mu[places] = onnx_estimate_mu(contender.bundle.files[model.model_file], rows[places])
    return mu


def _by_model(
    contender: Contender, table: FeatureTable, section_id: Sequence[str]
) -> list[tuple[ModelManifest, RowIndices]]:
    """Return the models of a table, each with the rows that it answers for; none without rows."""
    sections = np.array(section_id)
    own = [
        (model, np.flatnonzero(sections == model.section_id))
        for model in contender.manifest.models
        if model.table_digest == table.digest and model.section_id is not None
    ]
    taken = [str(model.section_id) for model, _ in own]
    model = contender.manifest.model_for(table.digest)
    if model is not None:
        own.append((model, np.flatnonzero(~np.isin(sections, taken))))
    return [(model, rows) for model, rows in own if len(rows)]


def _judgements(bundle: Bundle, model: ModelManifest, rows: FloatArray) -> list[Judgement]:
    # As the 32-bit numbers that arrive at a unit.
    rows = rows.astype(np.float32).astype(np.float64)
    mu, *errors = (onnx_estimate_mu(bundle.files[name], rows) for name in model.files)
    return [
        judgement(row, model, mu=float(mu[i]), expected_error_ratio=float(errors[0][i]) if errors else None)
        for i, row in enumerate(rows)
    ]


def _figures(said: Judgement, model: ModelManifest) -> tuple[float, float, float, float, float]:
    nothing = float("nan")
    if said.mu is None:
        return nothing, nothing, nothing, nothing, nothing
    if said.expected_error_ratio is None or said.mu_low is None or model.conformal is None:
        return said.mu, nothing, nothing, nothing, nothing
    mu_high = model.conformal.mu_high(said.mu, expected_error_ratio=said.expected_error_ratio)
    return said.mu, said.expected_error_ratio, said.mu_low, mu_high, model.conformal.coverage_frac
