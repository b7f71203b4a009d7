"""Lives are driven once, go on where they were, and are driven anew when cars, roads or code change."""

from dataclasses import replace

import numpy as np
import pytest

from tests.training.runs import made_up_runs
from training import life_simulation
from training.cars import Lives
from training.dataset import RUNS_FILE_NAME
from training.life_simulation import GROUPS_FOLDER_NAME, is_lived, live, lives_description
from vehicle_client.simulator.plan import SensorGrade

LIVES = Lives("test", 1, SensorGrade.IDEAL, 3, varied_vehicles=False)


@pytest.fixture
def driven(monkeypatch):
    """Count the groups that are driven, by made-up runs."""
    groups = []

    def made_up(lives, group):
        groups.append(group)
        runs = made_up_runs(12, seed=group)
        return replace(runs, run_key=tuple(f"{lives.name}/{group}/{key}" for key in runs.run_key))

    monkeypatch.setattr(life_simulation, "lived", made_up)
    return groups


def test_what_was_driven_is_not_driven_again(tmp_path, driven):
    first = live(LIVES, tmp_path, workers_count=1)
    again = live(LIVES, tmp_path, workers_count=1)
    assert driven == [0, 1, 2]
    assert len(first) == 36
    assert again.digest() == first.digest()
    assert is_lived(LIVES, tmp_path / RUNS_FILE_NAME)


def test_more_groups_keep_those_there_were(tmp_path, driven):
    live(LIVES, tmp_path, workers_count=1)
    told = []
    more = live(
        replace(LIVES, groups_count=5),
        tmp_path,
        workers_count=1,
        on_progress=lambda done, wanted: told.append((done, wanted)),
    )
    assert driven == [0, 1, 2, 3, 4]
    assert told == [(4, 5), (5, 5)]
    assert len(more) == 60
    assert not is_lived(LIVES, tmp_path / RUNS_FILE_NAME)


def test_a_group_whose_file_was_cut_short_is_driven_anew(tmp_path, driven):
    whole = live(LIVES, tmp_path, workers_count=1).digest()
    path = sorted((tmp_path / GROUPS_FOLDER_NAME).iterdir())[1]
    path.write_bytes(path.read_bytes()[:100])
    (tmp_path / RUNS_FILE_NAME).unlink()
    assert live(LIVES, tmp_path, workers_count=1).digest() == whole
    assert driven == [0, 1, 2, 1]


def test_other_code_drives_anew(tmp_path, driven, monkeypatch):
    live(LIVES, tmp_path, workers_count=1)
    monkeypatch.setattr(life_simulation, "code_digest", lambda *_names: "of other code")
    live(LIVES, tmp_path, workers_count=1)
    assert driven == [0, 1, 2, 0, 1, 2]


def test_the_order_is_that_of_the_groups(tmp_path, driven):
    runs = live(LIVES, tmp_path, workers_count=1)
    assert driven == sorted(driven)
    assert [int(key.split("/")[1]) for key in runs.run_key] == np.repeat([0, 1, 2], 12).tolist()


def test_descriptions_tell_sizes_and_sensors_apart():
    others = (LIVES, replace(LIVES, groups_count=4), replace(LIVES, grade=SensorGrade.AUTOMOTIVE))
    assert len({tuple(sorted(lives_description(lives).items())) for lives in others}) == 3
