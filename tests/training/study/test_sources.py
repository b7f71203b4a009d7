"""The data sets of the study are driven once, and are others with another seed, size or code."""

import pytest

from roadgrip.errors import ConfigurationError
from tests.training.runs import made_up_runs
from training import life_simulation
from training.dataset import RUNS_FILE_NAME
from training.designs import BASE_FRICTIONS_MU, Size
from training.study import sources
from training.study.datasets import DATA_SETS, Cars, DataSet
from training.study.sources import DesignSource, data_set
from vehicle_client.simulator.plan import SensorGrade

IDEAL, AUTOMOTIVE = SensorGrade.IDEAL, SensorGrade.AUTOMOTIVE
TINY = DataSet(
    "tiny", "random-roads", Size(1, random_roads_count=2), Size(1, random_roads_count=1), "for a test", seed=5
)

LIVES = DataSet("lives", "lives", Size(3), Size(2), "for a test", seed=5, lives=Cars.FLEET)


@pytest.fixture
def source(tmp_path, monkeypatch):
    monkeypatch.setattr(sources, "DATA_SETS", (TINY, LIVES))

    def made(*, quick: bool = True, seed: int = 1) -> DesignSource:
        return DesignSource(tmp_path, quick=quick, seed=seed, workers_count=1)

    return made


def test_data_sets_of_the_study_have_names_of_their_own():
    assert len({known.name for known in DATA_SETS}) == len(DATA_SETS)
    for known in DATA_SETS:
        assert known is data_set(known.name)
    with pytest.raises(ConfigurationError, match="no data set 'none'; there are paper"):
        data_set("none")


def test_the_digest_changes_with_seed_size_and_sensors(source):
    digests = {
        source().digest("tiny", IDEAL),
        source().digest("tiny", AUTOMOTIVE),
        source(seed=2).digest("tiny", IDEAL),
        source(quick=False).digest("tiny", IDEAL),
    }
    assert len(digests) == 4
    assert source().digest("tiny", IDEAL) in digests


def test_folders_are_told_apart(source):
    folders = {
        source(quick=quick, seed=seed).folder_of("tiny", grade).name
        for quick in (True, False)
        for seed in (1, 2)
        for grade in SensorGrade
    }
    assert len(folders) == 8
    assert source(quick=False).folder_of("tiny", IDEAL).name == "tiny-ideal"


@pytest.mark.sim
@pytest.mark.xdist_group("sim")
def test_a_data_set_is_driven_once(source):
    told: list[tuple[int, int]] = []
    assert not source().is_there("tiny", IDEAL)
    first = source().runs("tiny", IDEAL, lambda done, wanted: told.append((done, wanted)))
    runs_count = len(BASE_FRICTIONS_MU)
    assert len(first) == runs_count
    assert told[-1] == (runs_count, runs_count)
    assert source().is_there("tiny", IDEAL)
    assert not source(seed=2).is_there("tiny", IDEAL)
    written = source().folder_of("tiny", IDEAL) / RUNS_FILE_NAME
    before = written.stat().st_mtime_ns
    again = source().runs("tiny", IDEAL, lambda *_: None)
    assert again.digest() == first.digest()
    assert written.stat().st_mtime_ns == before


def test_lives_are_driven_as_lives(source, monkeypatch):
    """A group of cars takes seconds: the file alone is made up."""
    driven = []

    def made_up(lives, group):
        driven.append((lives.name, lives.seed, group, lives.varied_vehicles))
        return made_up_runs(12)

    monkeypatch.setattr(life_simulation, "lived", made_up)
    assert not source().is_there("lives", IDEAL)
    assert len(source().runs("lives", IDEAL, lambda *_: None)) == 24
    assert driven == [("lives", 5, group, True) for group in (0, 1)]
    assert source().is_there("lives", IDEAL)
    assert not source(quick=False).is_there("lives", IDEAL)
    assert not source().is_there("lives", AUTOMOTIVE)
    digests = {source(quick=quick, seed=seed).digest("lives", IDEAL) for quick in (True, False) for seed in (1, 2)}
    assert len(digests) == 4
    assert source().lives("tiny", IDEAL) is None
