"""The one door to mlflow: what studies and retrainings ran with and came to, and the register of models.

By default the records lie in an SQLite file of a folder, with their files beside it; look at them with
`roadgrip-train ui`, or with `mlflow ui --backend-store-uri sqlite:///build/study/mlflow.db`. Any tracking server can be
named instead. Nothing is sent anywhere else: the library's telemetry is off.
"""

from __future__ import annotations

import logging
import math
import os
import re
import sys
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from roadgrip.errors import ConfigurationError
from roadgrip.units import FloatArray

if TYPE_CHECKING:
    from mlflow.entities.model_registry import ModelVersion
    from mlflow.tracking import MlflowClient

DATABASE_FILE_NAME = "mlflow.db"
FILES_FOLDER_NAME = "mlflow-files"
# Read when the library is first imported. A server that is gone shall not hold a study up for minutes, either.
_SETTINGS = {
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
    "DO_NOT_TRACK": "true",
    "GIT_PYTHON_REFRESH": "quiet",
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "2",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "20",
}
MODEL_FOLDER_NAME = "model"
"""Of a run's files: the model as the library wants it."""
_MOST_LETTERS_COUNT = 500
_BATCH_COUNT = 100


class Tracker:
    """Records runs, one within another."""

    def __init__(self, *, address: str, experiment: str, files_folder: Path | None = None) -> None:
        """Open the records; the first time this takes seconds.

        Args:
            address: Of a tracking server, or of a database as mlflow names it.
            experiment: Name under which the runs stand; made if missing.
            files_folder: Where the files of a new experiment go; the server's choice if None.

        Raises:
            ConfigurationError: There is no server at the address, or it refuses.
        """
        self._address = address
        self._client = _client(address)
        with _errors_named(address):
            found = self._client.get_experiment_by_name(experiment)
            if found is None:
                place = None if files_folder is None else files_folder.resolve().as_uri()
                self._experiment_id = self._client.create_experiment(experiment, artifact_location=place)
            else:
                self._experiment_id = found.experiment_id

    def begin(
        self,
        name: str,
        *,
        parameters: Mapping[str, str | int | float],
        parent: TrackedRun | None = None,
        began_ago_s: float = 0.0,
    ) -> TrackedRun:
        """Return a run that is recorded from now on, or as if from a while ago; `TrackedRun.end` ends it.

        Args:
            name: For people.
            parameters: What it runs with.
            parent: The run it is a part of.
            began_ago_s: How long it has been going on.
        """
        tags = {} if parent is None else {"mlflow.parentRunId": parent.run_id}
        with _errors_named(self._address):
            made = self._client.create_run(
                self._experiment_id, run_name=name, tags=tags, start_time=_now_ms() - int(1000.0 * began_ago_s)
            )
        tracked = TrackedRun(self._client, self._address, made.info.run_id)
        tracked.parameters(parameters)
        return tracked


class TrackedRun:
    """One run of the records."""

    def __init__(self, client: MlflowClient, address: str, run_id: str) -> None:
        """Speak for a run that was made."""
        self._client = client
        self._address = address
        self.run_id = run_id

    def parameters(self, values: Mapping[str, str | int | float]) -> None:
        """Record what it runs with."""
        from mlflow.entities import Param

        entries = [Param(_key(name), str(value)[:_MOST_LETTERS_COUNT]) for name, value in values.items()]
        for i in range(0, len(entries), _BATCH_COUNT):
            with _errors_named(self._address):
                self._client.log_batch(self.run_id, params=entries[i : i + _BATCH_COUNT])

    def metrics(self, values: Mapping[str, float]) -> None:
        """Record what it came to; what is no finite number is left out."""
        from mlflow.entities import Metric

        now_ms = _now_ms()
        entries = [Metric(_key(name), value, now_ms, 0) for name, value in values.items() if math.isfinite(value)]
        for i in range(0, len(entries), _BATCH_COUNT):
            with _errors_named(self._address):
                self._client.log_batch(self.run_id, metrics=entries[i : i + _BATCH_COUNT])

    def word(self, name: str, value: str) -> None:
        """Record a word about it, such as a verdict."""
        with _errors_named(self._address):
            self._client.set_tag(self.run_id, _key(name), value)

    def file(self, path: Path, *, folder: str | None = None) -> None:
        """Keep a copy of a file, at the top or in a folder of the run's files."""
        with _errors_named(self._address):
            self._client.log_artifact(self.run_id, str(path), folder)

    def folder(self, path: Path, name: str) -> None:
        """Keep a copy of all that lies in a folder, under a name."""
        with _errors_named(self._address):
            self._client.log_artifacts(self.run_id, str(path), name)

    def data_set(self, name: str, *, digest: str, source: str, profile: str) -> None:
        """Record that it took a data set.

        Args:
            name: Of the data set.
            digest: Of its content.
            source: Where it comes from.
            profile: What else is known of it, as JSON.
        """
        from mlflow.entities import Dataset, DatasetInput, InputTag

        taken = Dataset(name=name, digest=digest, source_type="roadgrip", source=source, profile=profile)
        with _errors_named(self._address):
            self._client.log_inputs(self.run_id, [DatasetInput(taken, [InputTag("mlflow.data.context", "training")])])

    def end(self, *, well: bool = True) -> None:
        """End the run, well or as failed."""
        with _errors_named(self._address):
            self._client.set_terminated(self.run_id, status="FINISHED" if well else "FAILED")


def local_tracker(folder: Path, *, experiment: str) -> Tracker:
    """Return records in a folder: an SQLite file, and a folder of files beside it.

    Args:
        folder: Made if missing.
        experiment: Name under which the runs stand.
    """
    return Tracker(address=local_address(folder), experiment=experiment, files_folder=folder / FILES_FOLDER_NAME)


@dataclass(frozen=True, slots=True)
class RegisteredVersion:
    """A version of a registered model.

    Attributes:
        version: Its number; the first is 1.
        run_id: The run it came from.
        words: What was said of it, by name.
        made_unix_s: When it was registered.
    """

    version: int
    run_id: str
    words: Mapping[str, str]
    made_unix_s: float


class ModelRegister:
    """The versions of registered models, and the names that point to them."""

    def __init__(self, *, address: str) -> None:
        """Open the register.

        Args:
            address: Of a tracking server, or of a database as mlflow names it.

        Raises:
            ConfigurationError: There is no server at the address, or it refuses.
        """
        self._address = address
        self._client = _client(address)

    def add(
        self, name: str, *, run_id: str, words: Mapping[str, str], description: str, about_model: str = ""
    ) -> RegisteredVersion:
        """Return the version that the model of a run became; the run's `MODEL_FOLDER_NAME` holds it.

        Args:
            name: Of the model; made if missing.
            run_id: The run.
            words: To be said of the version.
            description: The same for people, as Markdown.
            about_model: What a new model is, for people.
        """
        with _errors_named(self._address):
            if not self._client.search_registered_models(f"name = '{name}'"):
                self._client.create_registered_model(name, description=about_model or None)
            place = f"{self._client.get_run(run_id).info.artifact_uri}/{MODEL_FOLDER_NAME}"
            made = self._client.create_model_version(
                name, place, run_id, tags=_tags(words), description=description or None
            )
        return _version_of(made)

    def versions(self, name: str) -> list[RegisteredVersion]:
        """Return the versions of a model, the newest first; none of a model that was never registered."""
        with _errors_named(self._address):
            found = self._client.search_model_versions(f"name = '{name}'")
        return sorted(map(_version_of, found), key=lambda version: -version.version)

    def aliases(self, name: str) -> dict[str, int]:
        """Return which version each alias of a model points to."""
        with _errors_named(self._address):
            return {
                alias: int(version)
                for model in self._client.search_registered_models(f"name = '{name}'")
                for alias, version in model.aliases.items()
            }

    def set_alias(self, name: str, alias: str, version: int) -> None:
        """Let an alias point to a version of a model."""
        with _errors_named(self._address):
            self._client.set_registered_model_alias(name, alias, str(version))

    def say(self, name: str, version: int, words: Mapping[str, str]) -> None:
        """Say something of a version of a model."""
        with _errors_named(self._address):
            for key, value in _tags(words).items():
                self._client.set_model_version_tag(name, str(version), key, value)

    def run(self, run_id: str) -> TrackedRun:
        """Return a run of before, to be given more words and files."""
        return TrackedRun(self._client, self._address, run_id)

    def fetch(self, run_id: str, folder: str, into: Path) -> bool:
        """Put the files that a run keeps in a folder into one of that name, and return whether there were any.

        Args:
            run_id: The run.
            folder: Its folder.
            into: Where the folder goes; must exist.
        """
        with _errors_named(self._address):
            if not self._client.list_artifacts(run_id, folder):
                return False
            self._client.download_artifacts(run_id, folder, str(into))
        return True


def write_onnx_model(
    model: bytes,
    folder: Path,
    *,
    feature_names: Sequence[str],
    answer_names: Sequence[str],
    example_rows: FloatArray,
    requirements: Sequence[str],
    words: Mapping[str, str],
) -> None:
    """Write an ONNX model as the library wants models: with signature, example and what it needs to run.

    Nothing is asked over a network, and nothing of this machine is looked up: what it needs is given.

    Args:
        model: With one input (n, features), float32, and outputs of (n, 1).
        folder: Must not exist.
        feature_names: Of the input's columns.
        answer_names: Of the outputs.
        example_rows: Some inputs. (m, features)
        requirements: What has to be installed to run it, as pip wants it.
        words: Kept with the model.
    """
    with _quiet():
        import onnx
        import pandas as pd  # type: ignore[import-untyped]
        from mlflow.models import ModelSignature
        from mlflow.onnx import save_model
        from mlflow.types import ColSpec, DataType, Schema

        save_model(
            onnx.load_from_string(model),
            str(folder),
            signature=ModelSignature(
                inputs=Schema([ColSpec(DataType.float, name) for name in feature_names]),
                outputs=Schema([ColSpec(DataType.float, name) for name in answer_names]),
            ),
            input_example=pd.DataFrame(example_rows.astype("float32"), columns=list(feature_names)),
            pip_requirements=list(requirements),
            onnx_execution_providers=["CPUExecutionProvider"],
            save_as_external_data=False,
            metadata=dict(words),
        )


def local_address(folder: Path) -> str:
    """Return the address of the records in a folder; the folder is made if missing."""
    folder.mkdir(parents=True, exist_ok=True)
    return f"sqlite:///{(folder / DATABASE_FILE_NAME).resolve()}"


def server_command(address: str, *, files_folder: Path, port: int) -> list[str]:
    """Return the command that serves the library's own pages on a database of records, on this machine alone.

    Args:
        address: Of the database.
        files_folder: Where the files of experiments go that are made there.
        port: On 127.0.0.1.
    """
    return [
        *(sys.executable, "-m", "mlflow", "server", "--backend-store-uri", address),
        *("--default-artifact-root", files_folder.resolve().as_uri(), "--no-serve-artifacts"),
        *("--host", "127.0.0.1", "--port", str(port), "--workers", "1"),
    ]


def server_environment() -> dict[str, str]:
    """Return the environment to serve in: this one, where the library tells nobody and starts no jobs of its own."""
    return {**_SETTINGS, "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false", **os.environ}


def _client(address: str) -> MlflowClient:
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    with _errors_named(address):
        from mlflow.tracking import MlflowClient

        # Not `mlflow.set_tracking_uri`: that would hold for everything in this process.
        return MlflowClient(tracking_uri=address, registry_uri=address)


def _version_of(made: ModelVersion) -> RegisteredVersion:
    return RegisteredVersion(
        version=int(made.version),
        run_id=str(made.run_id),
        words=dict(made.tags),
        made_unix_s=made.creation_timestamp / 1000.0,
    )


def _tags(words: Mapping[str, str]) -> dict[str, str]:
    return {_key(name): value[:_MOST_LETTERS_COUNT] for name, value in words.items()}


@contextmanager
def _errors_named(address: str) -> Iterator[None]:
    """Turn whatever the library or its transport raises into one error that names the address."""
    with _quiet():
        try:
            yield
        except Exception as error:  # the library lets through what its stores raise, each in a way of its own
            raise ConfigurationError(f"cannot record at {address}: {error}") from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the library's own warnings and its tale of making tables to itself."""
    loggers = [logging.getLogger(name) for name in ("mlflow", "mlflow.store.db.utils", "alembic")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def _now_ms() -> int:
    return int(1000.0 * time.time())


def _key(name: str) -> str:
    """Return a name as the records allow it."""
    return re.sub(r"[^\w./ -]", "_", name)[:250]
