"""From a bundle folder to a model that answers.

One row costs about 25 microseconds of CPU, a hop to another thread and back about twice that. So the unit asks the
model on the event loop, and only loading a bundle belongs on another thread.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime

from roadgrip.bundle import MANIFEST_NAME, BundleManifest, check_files, manifest_from_json
from roadgrip.errors import BundleError
from roadgrip.features import FEATURES
from roadgrip.units import FloatArray
from rsu_app.usecases.readiness import check_golden

FILE_LIMIT_BYTES = 256 * 1024 * 1024
"""A larger file is no model of ours; reading it could take the unit's memory."""

_MINIMUM = np.array([f.minimum for f in FEATURES], dtype=np.float32)
_MAXIMUM = np.array([f.maximum for f in FEATURES], dtype=np.float32)


class OnnxFrictionModel:
    """A model in a session of its own; see `rsu_app.ports.FrictionModel` for what it promises.

    Args:
        manifest: What the bundle says about itself.
        model: The model's bytes, as the manifest's digest names them.

    Raises:
        BundleError: The bytes are no model with one input of the table's width.
    """

    def __init__(self, manifest: BundleManifest, model: bytes) -> None:
        self._manifest = manifest
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        # Threads that wait by spinning burn most of a core on an idle unit.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        # Warnings about graph details are for the laboratory.
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        except Exception as error:
            # The library's exceptions share no base class of their own.
            raise BundleError(f"bundle {manifest.bundle_id}: {manifest.model_file} is no model: {error}") from error
        inputs = self._session.get_inputs()
        if len(inputs) != 1 or inputs[0].shape[-1] != len(FEATURES):
            shapes = [entry.shape for entry in inputs]
            raise BundleError(f"bundle {manifest.bundle_id}: the model takes {shapes}, not rows of {len(FEATURES)}")
        self._input_name = inputs[0].name

    @property
    def manifest(self) -> BundleManifest:
        """What the bundle says about itself."""
        return self._manifest

    def estimate_mu(self, rows: FloatArray) -> FloatArray:
        """Return the friction estimate of each row.

        Args:
            rows: Features in the order of the table. (n, 78)

        Returns:
            The estimates. (n,)

        Raises:
            BundleError: The model does not answer one number per row.
            ValueError: A row holds a value outside its feature's range; the model would answer with a plausible
                number even to infinity.
        """
        with np.errstate(over="ignore"):
            values = np.ascontiguousarray(rows, dtype=np.float32)
        if values.ndim != 2 or values.shape[1] != len(FEATURES):
            raise ValueError(f"rows of {len(FEATURES)} features are asked for, not {values.shape}")
        # Written so that NaN, which compares false with everything, is refused too.
        inside = (values >= _MINIMUM) & (values <= _MAXIMUM)
        if not inside.all():
            column = int(np.argmin(inside.all(axis=0)))
            raise ValueError(f"{FEATURES[column].name} holds a value that no passage can have")
        try:
            answers = self._session.run(None, {self._input_name: values})[0]
        except Exception as error:
            raise BundleError(f"bundle {self._manifest.bundle_id} does not answer: {error}") from error
        answers = np.asarray(answers, dtype=np.float64)
        if answers.size != len(values):
            raise BundleError(f"bundle {self._manifest.bundle_id} gave {answers.shape} for {len(values)} rows")
        return answers.reshape(-1)


def load_bundle(folder: Path) -> OnnxFrictionModel:
    """Return the model of a bundle after everything that can be checked was checked.

    The manifest contradicts neither itself nor this software's feature table; every file is the one it names; the
    model answers its golden vectors.

    Args:
        folder: Holds `manifest.json` and the files it names, nothing else.

    Raises:
        BundleError: The bundle must not be trusted; the message says why.
        FeatureTableError: It was made for another feature table.
    """
    files = _read_files(folder)
    text = files.pop(MANIFEST_NAME, None)
    if text is None:
        raise BundleError(f"{folder} holds no {MANIFEST_NAME}")
    try:
        manifest = manifest_from_json(text.decode())
        check_files(manifest, files)
        model = OnnxFrictionModel(manifest, files[manifest.model_file])
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
