"""The one door to mlflow: what every study ran with and came to, where it can be searched and compared.

By default the records lie in an SQLite file of the study's folder, with their files beside it; look at them with
`mlflow ui --backend-store-uri sqlite:///build/study/mlflow.db`. Any tracking server can be named instead. Nothing is
sent anywhere else: the library's telemetry is off.
"""

from __future__ import annotations

import logging
import math
import os
import re
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from roadgrip.errors import ConfigurationError

if TYPE_CHECKING:
    from mlflow.tracking import MlflowClient

DATABASE_FILE_NAME = "mlflow.db"
FILES_FOLDER_NAME = "mlflow-files"
# Read when the library is first imported. A server that is gone shall not hold a study up for minutes, either.
_SETTINGS = {
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "DO_NOT_TRACK": "true",
    "GIT_PYTHON_REFRESH": "quiet",
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "2",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "20",
}
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
        for name, value in _SETTINGS.items():
            os.environ.setdefault(name, value)
        with _errors_named(address):
            from mlflow.tracking import MlflowClient

            # Not `mlflow.set_tracking_uri`: that would hold for everything in this process.
            self._client = MlflowClient(tracking_uri=address, registry_uri=address)
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

    def file(self, path: Path) -> None:
        """Keep a copy of a file."""
        with _errors_named(self._address):
            self._client.log_artifact(self.run_id, str(path))

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
    folder.mkdir(parents=True, exist_ok=True)
    address = f"sqlite:///{(folder / DATABASE_FILE_NAME).resolve()}"
    return Tracker(address=address, experiment=experiment, files_folder=folder / FILES_FOLDER_NAME)


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
