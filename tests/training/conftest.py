"""Records of mlflow for tests: making their tables takes seconds, copying them takes none."""

import shutil
from pathlib import Path

import pytest

from training.laboratory import Laboratory
from training.tracking import DATABASE_FILE_NAME, ModelRegister, local_address


@pytest.fixture(scope="session")
def empty_records(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a database of records with nothing in it, to be copied."""
    folder = tmp_path_factory.mktemp("empty-records")
    assert ModelRegister(address=local_address(folder)).versions("none") == []
    return folder / DATABASE_FILE_NAME


@pytest.fixture(scope="session")
def made_lab(empty_records: Path, tmp_path_factory: pytest.TempPathFactory) -> Laboratory:
    """Return a laboratory that tests share; what one leaves there another one sees."""
    lab = Laboratory(tmp_path_factory.mktemp("lab"))
    shutil.copy(empty_records, lab.folder / DATABASE_FILE_NAME)
    return lab


@pytest.fixture
def lab(empty_records: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Laboratory:
    """Return an empty laboratory with empty records."""
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    made = Laboratory(tmp_path / "lab")
    made.folder.mkdir()
    shutil.copy(empty_records, made.folder / DATABASE_FILE_NAME)
    return made
