"""What every test may lean on: the project's root, reproducible chance, and how hard hypothesis tries."""

import os
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from roadgrip.features import TABLES, FeatureTable
from tests.roadgrip.tables import WIDER_TABLE

PROJECT_ROOT = Path(__file__).resolve().parents[1]

# Two busy cores make wall-clock deadlines flaky, so none. Continuous integration repeats the same few examples every
# time; a developer's machine looks for new ones.
settings.register_profile("dev", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, max_examples=50)
settings.register_profile(
    "long", deadline=None, max_examples=2_000, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci" if os.environ.get("CI") else "dev"))


@pytest.fixture(scope="session")
def project_root() -> Path:
    """Return the directory that holds pyproject.toml."""
    return PROJECT_ROOT


@pytest.fixture
def rng() -> np.random.Generator:
    """Return the same chance for every test, so that a failure repeats."""
    return np.random.default_rng(20_260_117)


@pytest.fixture
def wider_table(monkeypatch: pytest.MonkeyPatch) -> FeatureTable:
    """Return a feature table with more columns, spoken as the newest one until the test ends."""
    monkeypatch.setitem(cast("dict[str, FeatureTable]", TABLES), WIDER_TABLE.digest, WIDER_TABLE)
    return WIDER_TABLE
