from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from roadgrip.errors import FeatureTableError
from roadgrip.features import PAPER_TABLE, FeatureTable
from tests.training.runs import made_up_runs, shuffled
from training.dataset import DatasetError, Runs, joined, read_description, read_runs, write_runs


def test_runs_come_back_from_parquet_as_they_were_written(tmp_path: Path) -> None:
    runs = made_up_runs(40)
    write_runs(runs, tmp_path / "a.parquet", description={"design": "made up"})
    assert read_runs(tmp_path / "a.parquet").digest() == runs.digest()
    assert read_description(tmp_path / "a.parquet")["design"] == "made up"


def test_a_folder_of_shards_reads_as_one_table(tmp_path: Path) -> None:
    first, second = made_up_runs(30, seed=1), made_up_runs(20, seed=2)
    write_runs(first, tmp_path / "0.parquet", description={})
    write_runs(second, tmp_path / "1.parquet", description={})
    assert len(read_runs(tmp_path)) == 50


def test_digest_does_not_depend_on_the_order_of_runs() -> None:
    runs = made_up_runs(60)
    assert shuffled(runs, seed=3).digest() == runs.digest()


def test_digest_sees_one_changed_number_label_or_outcome() -> None:
    runs = made_up_runs(60)
    feature, label = runs.features.copy(), runs.labels["label_mu"].copy()
    feature[7, 11] += 1e-3
    label[7] += 1e-6
    changed = (
        replace(runs, features=feature),
        replace(runs, labels={**runs.labels, "label_mu": label}),
        replace(runs, outcome=("left_road", *runs.outcome[1:])),
    )
    assert len({runs.digest(), *(other.digest() for other in changed)}) == 4


def test_a_run_without_a_label_or_with_a_hole_in_its_features_is_not_usable() -> None:
    runs = made_up_runs(40)
    runs.labels["label_mu"][0] = np.nan
    runs.features[1, -1] = np.nan
    assert np.flatnonzero(~runs.usable).tolist() == [0, 1, 9, 19, 29, 39]


def test_a_table_whose_writing_breaks_off_leaves_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.parquet"
    write_runs(made_up_runs(20), path, description={})

    def broken_off(_table: object, where: Path, **_options: object) -> None:
        where.write_bytes(b"half a ta")
        raise OSError

    monkeypatch.setattr(pq, "write_table", broken_off)
    with pytest.raises(OSError):
        write_runs(made_up_runs(30), path, description={})
    assert len(read_runs(tmp_path)) == 20


def test_failed_runs_stay_in_the_table_and_are_not_usable(tmp_path: Path) -> None:
    write_runs(made_up_runs(40), tmp_path / "a.parquet", description={})
    runs = read_runs(tmp_path)
    assert len(runs) == 40
    assert runs.usable.sum() == 36
    assert [runs.outcome[i] for i in np.flatnonzero(~runs.usable)] == ["left_road"] * 4


def test_a_table_that_lacks_a_column_says_which(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    write_runs(made_up_runs(20), path, description={})
    pq.write_table(pq.read_table(path).drop_columns(["wear_ratio"]), path)
    with pytest.raises(DatasetError, match="wear_ratio"):
        read_runs(path)


def test_an_empty_folder_is_an_error_that_says_how_to_fill_it(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="roadgrip-train simulate"):
        read_runs(tmp_path)


def test_a_file_that_is_no_table_of_runs_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    path.write_bytes(b"not parquet")
    with pytest.raises(DatasetError, match="no table of runs"):
        read_runs(path)


def test_a_table_made_for_other_features_is_refused_with_both_digests(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    write_runs(made_up_runs(20), path, description={})
    table = pq.read_table(path)
    table = table.replace_schema_metadata({b"roadgrip": json.dumps({"table_digest": "0123456789abcdef"}).encode()})
    pq.write_table(table, path)
    with pytest.raises(FeatureTableError, match="0123456789abcdef"):
        read_runs(path)


def test_runs_of_every_table_come_back_with_their_own_columns(tmp_path: Path, wider_table: FeatureTable) -> None:
    for table in (PAPER_TABLE, wider_table):
        runs = made_up_runs(30, table=table)
        write_runs(runs, tmp_path / "a.parquet", description={})
        again = read_runs(tmp_path / "a.parquet")
        assert again.table == table
        assert again.digest() == runs.digest()
        assert read_description(tmp_path / "a.parquet")["table_digest"] == table.digest


def test_files_of_different_tables_are_no_one_data_set(tmp_path: Path, wider_table: FeatureTable) -> None:
    write_runs(made_up_runs(30, table=PAPER_TABLE), tmp_path / "0.parquet", description={})
    write_runs(made_up_runs(30, table=wider_table), tmp_path / "1.parquet", description={})
    with pytest.raises(FeatureTableError, match=f"{wider_table.digest}"):
        read_runs(tmp_path)


def test_runs_of_a_newer_table_hold_those_of_the_older_one(wider_table: FeatureTable) -> None:
    runs = made_up_runs(30, table=wider_table)
    older = runs.for_table(PAPER_TABLE)
    assert older.table == PAPER_TABLE
    assert np.array_equal(older.features[:, :55], runs.features[:, :55], equal_nan=True)
    assert np.array_equal(older.features[:, 55:], runs.features[:, len(wider_table.kinematic) :], equal_nan=True)
    assert older.run_key == runs.run_key
    assert older.for_table(PAPER_TABLE) is older
    with pytest.raises(FeatureTableError):
        older.for_table(wider_table)


def test_columns_are_chosen_by_name() -> None:
    runs = made_up_runs(20)
    names = ("section_length_m", "steer_mean_rad")
    assert np.array_equal(runs.columns(names), runs.features[:, [-1, 0]], equal_nan=True)
    with pytest.raises(FeatureTableError, match="no column colour"):
        runs.columns(["colour"])


def test_features_of_another_width_are_no_runs_of_the_table() -> None:
    runs = made_up_runs(20)
    with pytest.raises(DatasetError, match="not rows of"):
        replace(runs, features=runs.features[:, :-1])


def test_joining_keeps_the_table(wider_table: FeatureTable) -> None:
    parts: list[Runs] = [made_up_runs(10, seed=i, table=wider_table) for i in range(2)]
    assert joined(parts).table == wider_table
    assert parts[0].rows(np.arange(3)).table == wider_table
