from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.training.runs import made_up_runs
from training.dataset import DatasetError
from training.fit_files import read_fit, read_trees, write_fit
from training.fit_parameters import FitParameters
from training.regressor import estimate_mu, fit

PARAMETERS = FitParameters(trees_count=20, seed=3)


def test_a_fit_reads_back_with_its_split_and_answers_the_same(tmp_path: Path) -> None:
    runs = made_up_runs(400)
    fitted = fit(runs, PARAMETERS)
    write_fit(fitted, tmp_path, runs=runs, parameters=PARAMETERS)
    again, parameters = read_fit(tmp_path, runs=runs)
    rows = np.nan_to_num(runs.features)
    assert np.array_equal(estimate_mu(again.booster, rows), estimate_mu(fitted.booster, rows))
    assert np.array_equal(again.test_rows, fitted.test_rows)
    assert (again.metrics, parameters) == (fitted.metrics, PARAMETERS)


def test_a_fit_is_not_taken_for_one_of_other_data(tmp_path: Path) -> None:
    runs = made_up_runs(400)
    write_fit(fit(runs, PARAMETERS), tmp_path, runs=runs, parameters=PARAMETERS)
    with pytest.raises(DatasetError, match="fitted to data set"):
        read_fit(tmp_path, runs=made_up_runs(400, seed=9))


def test_an_empty_folder_says_how_to_fill_it(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="roadgrip-train fit"):
        read_trees(tmp_path)


def test_a_file_that_holds_no_trees_is_refused(tmp_path: Path) -> None:
    (tmp_path / "trees.ubj").write_bytes(b"no trees")
    with pytest.raises(DatasetError, match="holds no trees"):
        read_trees(tmp_path)
