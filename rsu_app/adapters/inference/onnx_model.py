"""From a bundle folder to models that answer.

One row costs a model about 25 microseconds of CPU, a hop to another thread and back about twice that. So the unit
asks its models on the event loop, and only loading a bundle belongs on another thread.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from roadgrip.bundle import MANIFEST_NAME, BundleManifest, ModelManifest, check_files
from roadgrip.bundle_json import manifest_from_json
from roadgrip.errors import BundleError
from roadgrip.features import table_of
from roadgrip.units import FloatArray
from rsu_app.heap import give_back_freed_memory
from rsu_app.ports import Estimates
from rsu_app.usecases.readiness import check_golden

FILE_LIMIT_BYTES = 256 * 1024 * 1024
"""A larger file is no model of ours; reading it could take the unit's memory."""


class OnnxFrictionModel:
    """The models of a bundle in sessions of their own; see `rsu_app.ports.FrictionModel` for what they promise.

    Args:
        manifest: What the bundle says about itself.
        files: The models' bytes by file name, as the manifest's digests name them.

    Raises:
        BundleError: Some bytes are no model with one input of its table's width.
    """

    def __init__(self, manifest: BundleManifest, files: Mapping[str, bytes]) -> None:
        self._manifest = manifest
        self._served = {
            (model.table_digest, model.section_id): _TableModel(manifest.bundle_id, model, files)
            for model in manifest.models
        }

    @property
    def manifest(self) -> BundleManifest:
        """What the bundle says about itself."""
        return self._manifest

    def estimate(self, table_digest: str, rows: FloatArray, *, section_id: str | None = None) -> Estimates:
        """Return the friction estimate of each row, and its expected error if the bundle has a model for it.

        Args:
            table_digest: One of the feature tables the bundle serves.
            rows: Features in the order of that table. (n, columns)
            section_id: Where they were driven; None asks the global model.

        Raises:
            BundleError: No model for this table, or it does not answer one number per row.
            ValueError: A row holds a value outside its feature's range; the model would answer with a plausible
                number even to infinity.
        """
        served = self._served.get((table_digest, section_id)) or self._served.get((table_digest, None))
        if served is None:
            raise BundleError(f"bundle {self._manifest.bundle_id} has no model for feature table {table_digest}")
        return served.estimate(rows)


class _TableModel:
    """What a bundle holds for one feature table: the friction model, perhaps one for its expected error."""

    def __init__(self, bundle_id: str, manifest: ModelManifest, files: Mapping[str, bytes]) -> None:
        self._table = table_of(manifest.table_digest, subject=f"bundle {bundle_id}")
        self._minimum = self._table.minimum.astype(np.float32)
        self._maximum = self._table.maximum.astype(np.float32)
        regressors = [
            _Regressor(f"bundle {bundle_id}", name, files[name], width=len(self._table)) for name in manifest.files
        ]
        self._friction = regressors[0]
        self._error = regressors[1] if len(regressors) > 1 else None

    def estimate(self, rows: FloatArray) -> Estimates:
        """Return what the models answer to rows that they may be asked about."""
        with np.errstate(over="ignore"):
            values = np.ascontiguousarray(rows, dtype=np.float32)
        if values.ndim != 2 or values.shape[1] != len(self._table):
            raise ValueError(f"rows of {len(self._table)} features are asked for, not {values.shape}")
        # Written so that NaN, which compares false with everything, is refused too.
        inside = (values >= self._minimum) & (values <= self._maximum)
        if not inside.all():
            column = int(np.argmin(inside.all(axis=0)))
            raise ValueError(f"{self._table.names[column]} holds a value that no passage can have")
        return Estimates(
            mu=self._friction.answers(values),
            expected_error_ratio=None if self._error is None else self._error.answers(values),
        )


class _Regressor:
    """One ONNX graph: rows of features in, a number per row out."""

    def __init__(self, subject: str, name: str, content: bytes, *, width: int) -> None:
        self._subject = f"{subject}: {name}"
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        # Threads that wait by spinning burn most of a core on an idle unit.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        # Memory that a batch took is not kept for the next: the few arrays of one are no work for the C library.
        options.enable_cpu_mem_arena = False
        options.enable_mem_pattern = False
        # Warnings about graph details are for the laboratory.
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:
            # The library's exceptions share no base class of their own.
            raise BundleError(f"{self._subject} is no model: {error}") from error
        # The bytes are kept to begin again with another processor, and there is none.
        self._session._model_bytes = None  # noqa: SLF001
        # After each, not once after all: 5 MB less, since the next one does not settle between what was freed.
        give_back_freed_memory()
        inputs = self._session.get_inputs()
        if len(inputs) != 1 or inputs[0].shape[-1] != width:
            shapes = [entry.shape for entry in inputs]
            raise BundleError(f"{self._subject} takes {shapes}, not rows of {width}")
        self._input_name = inputs[0].name

    def answers(self, values: NDArray[np.float32]) -> FloatArray:
        """Return a number per row. (n,)"""
        try:
            answers = self._session.run(None, {self._input_name: values})[0]
        except Exception as error:
            raise BundleError(f"{self._subject} does not answer: {error}") from error
        answers = np.asarray(answers, dtype=np.float64)
        if answers.size != len(values):
            raise BundleError(f"{self._subject} gave {answers.shape} for {len(values)} rows")
        return answers.reshape(-1)


def load_bundle(folder: Path) -> OnnxFrictionModel:
    """Return the models of a bundle after everything that can be checked was checked.

    The manifest contradicts neither itself nor this software's feature tables; every file is the one it names; the
    models answer their golden vectors.

    Args:
        folder: Holds `manifest.json` and the files it names, nothing else.

    Raises:
        BundleError: The bundle must not be trusted; the message says why.
        FeatureTableError: It was made for a feature table that this software does not speak.
    """
    model = _checked_model(folder, _read_files(folder))
    give_back_freed_memory()
    return model


def _checked_model(folder: Path, files: dict[str, bytes]) -> OnnxFrictionModel:
    text = files.pop(MANIFEST_NAME, None)
    if text is None:
        raise BundleError(f"{folder} holds no {MANIFEST_NAME}")
    try:
        manifest = manifest_from_json(text.decode())
        check_files(manifest, files)
        model = OnnxFrictionModel(manifest, files)
        check_golden(model)
    except UnicodeDecodeError as error:
        raise BundleError(f"{folder / MANIFEST_NAME} is no text") from error
    except BundleError as error:
        raise BundleError(f"{folder}: {error}") from error
    return model


def _read_files(folder: Path) -> dict[str, bytes]:
    try:
        paths = [path for path in sorted(folder.iterdir()) if not path.name.startswith(".")]
        files: dict[str, bytes] = {}
        for path in paths:
            if not path.is_file() or path.stat().st_size > FILE_LIMIT_BYTES:
                raise BundleError(f"{path} is no file that belongs into a bundle")
            files[path.name] = path.read_bytes()
    except OSError as error:
        raise BundleError(f"cannot read {folder} as a bundle: {error.strerror or error}") from error
    return files
