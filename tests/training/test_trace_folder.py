"""Folders of recorded drives: what is read, what is said of a file that cannot be."""

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from roadgrip.errors import ConfigurationError
from tests.training.recorded_drives import csv_of, drive, write_folder
from training.evaluation import RecordedDrive
from training.reference_drives import ReferenceFormat
from training.trace_folder import drives_of, open_folder, read_as
from vehicle_client.recording.own_columns import columns_of_trace
from vehicle_client.vehicle_profile import PAPER_VEHICLE, toml_of_profile

TRACE = drive()
CSV = csv_of(TRACE)


def all_of(folder: Path, **more: Any) -> list[Any]:
    source = open_folder(folder, **more)
    return [each for file in source.files for each in drives_of(file, source)]


def only(folder: Path, **more: Any) -> RecordedDrive:
    (found,) = all_of(folder, **more)
    assert isinstance(found, RecordedDrive), found
    return found


def refusal(folder: Path, **more: Any) -> str:
    (found,) = all_of(folder, **more)
    assert isinstance(found, tuple), found
    return str(found[1])


def as_table(**more):
    return pa.table({**columns_of_trace(TRACE), **more})


@pytest.mark.parametrize("name", ["drive.csv", "drive.csv.gz", "inner/drive.parquet", "UPPER.CSV"])
def test_a_drive_is_read_from_any_kind_of_table(tmp_path, name):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    if name.endswith(".parquet"):
        pq.write_table(as_table(driver=["somebody"] * TRACE.samples_count), path)
    else:
        path.write_bytes(gzip.compress(CSV) if name.endswith(".gz") else CSV)
    found = only(tmp_path)
    assert found.name == name
    assert np.array_equal(found.trace.yaw_rate_radps, TRACE.yaw_rate_radps)
    assert np.array_equal(found.trace.wheel_speed_mps, TRACE.wheel_speed_mps)
    assert found.friction_mu is None
    assert found.step_s == pytest.approx(0.01)


def test_a_single_file_is_read_without_its_neighbours(tmp_path):
    write_folder(tmp_path / "drives", "file,label_mu\nslow.csv,0.4\nquick.csv,0.5\n")
    (found,) = all_of(tmp_path / "drives" / "quick.csv")
    assert (found.name, found.friction_mu[0]) == ("quick.csv", 0.5)


def test_several_drives_of_one_file_are_told_apart_by_their_key(tmp_path):
    n = TRACE.samples_count
    two = pa.concat_tables([as_table(run_key=["a"] * n), as_table(run_key=["b"] * n)])
    pq.write_table(two, tmp_path / "many.parquet")
    (tmp_path / "labels.csv").write_text("file,label_mu\nmany.parquet#b,0.6\n", encoding="utf-8")
    first, second = all_of(tmp_path)
    assert (first.name, second.name) == ("many.parquet#a", "many.parquet#b")
    assert first.friction_mu is None
    assert second.friction_mu[0] == 0.6
    assert second.trace.samples_count == n


def test_what_the_folder_says_of_its_drives_is_taken(tmp_path):
    car = toml_of_profile(PAPER_VEHICLE).replace("Volvo XC90 2015", "Van")
    folder = write_folder(
        tmp_path / "drives", "file,section,label_mu,group,vehicle\nslow.csv, s-bend ,0.3,night,van.toml\n"
    )
    (folder / "van.toml").write_text(car, encoding="utf-8")
    (folder / "vehicle.toml").write_text(car.replace("Van", "Car"), encoding="utf-8")
    found = {each.name: each for each in all_of(folder)}
    slow, quick = found["slow.csv"], found["quick.csv"]
    assert (slow.section_id, slow.group, slow.vehicle.name, slow.friction_mu[0]) == ("s-bend", "night", "Van", 0.3)
    assert (quick.section_id, quick.group, quick.vehicle.name, quick.friction_mu) == ("", "", "Car", None)
    assert [section.section_id for section in open_folder(folder).sections] == ["hairpin", "s-bend"]


def test_a_column_of_labels_is_kept_sample_by_sample(tmp_path):
    label = np.linspace(0.3, 0.6, TRACE.samples_count)
    (tmp_path / "drive.csv").write_bytes(csv_of(TRACE, label_mu=label))
    told = only(tmp_path).friction_mu
    assert told is not None
    assert np.allclose(told, label)


def test_fewer_rows_a_second_are_read_and_told(tmp_path):
    columns = {name: values[::2] for name, values in columns_of_trace(TRACE).items()}
    pq.write_table(pa.table(columns), tmp_path / "fifty.parquet")
    found = only(tmp_path)
    assert found.step_s == pytest.approx(0.02)
    assert np.allclose(np.diff(found.trace.time_s), 0.01)


def test_columns_with_names_and_units_of_their_own_are_read_by_a_mapping(tmp_path):
    columns = {f"sim_{name}": values for name, values in columns_of_trace(TRACE).items()}
    columns["sim_yaw_rate_radps"] = -np.rad2deg(columns["sim_yaw_rate_radps"])
    pq.write_table(pa.table(columns), tmp_path / "theirs.parquet")
    units = {"accel_x": "m/s2", "accel_y": "m/s2", "roll_rate": "rad/s", "steer": "rad"}
    wheels = [f"wheel_{where}" for where in ("front_left", "front_right", "rear_left", "rear_right")]
    suffix = {"m/s2": "mps2", "rad/s": "radps", "rad": "rad", "m/s": "mps"}
    lines = ['time_column = "sim_time_s"', '[yaw_rate]\ncolumn = "sim_yaw_rate_radps"\nunit = "deg/s"\ngain = -1']
    for name, unit in (units | dict.fromkeys(wheels, "m/s")).items():
        lines.append(f'[{name}]\ncolumn = "sim_{name}_{suffix[unit]}"\nunit = "{unit}"')
    (tmp_path / "signals.toml").write_text("\n".join(lines), encoding="utf-8")
    found = only(tmp_path, reading=read_as(signals=tmp_path / "signals.toml"))
    assert np.allclose(found.trace.yaw_rate_radps, TRACE.yaw_rate_radps)


def test_public_recordings_come_with_their_car(tmp_path):
    (tmp_path / "drive.csv").write_bytes(b"t_s,ax\n0,0\n0.01,0\n")
    ferrari = read_as(recorded_as=ReferenceFormat.FERRARI_250LM)
    assert open_folder(tmp_path, ferrari).reading.vehicle.geometry.wheelbase_m == 2.40
    assert "no column ay, beta_ref" in refusal(tmp_path, reading=ferrari)


def with_column(name, values) -> bytes:
    return csv_of(TRACE, **{name: values})


@pytest.mark.parametrize(
    ("content", "needle"),
    [
        (CSV.replace(b"steer_rad", b"steering", 1), "no column steer_rad; there are time_s, accel_x_mps2"),
        (b"a,b\nx,y\n", "line 2: could not convert"),
        (b"\x1f\x8bnothing", "is no CSV file"),
        (b"", "no column time_s"),
        (with_column("time_s", 1000.0 * TRACE.time_s), "rows come every 10 s; 100 a second are asked for, 20 are the"),
        (with_column("time_s", -TRACE.time_s), "backwards"),
        (
            with_column("label_mu", np.full(TRACE.samples_count, 45.0)),
            "label_mu is 45, not above 0 and at most 1.5; is it",
        ),
        (with_column("label_mu", np.zeros(TRACE.samples_count)), "label_mu is 0, not above 0"),
    ],
)
def test_a_table_that_is_no_drive_is_said_to_be_none(tmp_path, content, needle):
    (tmp_path / "drive.csv").write_bytes(content)
    assert needle in refusal(tmp_path)


def test_a_broken_parquet_file_is_said_to_be_none(tmp_path):
    (tmp_path / "drive.parquet").write_bytes(b"PAR1 or so")
    assert "is no Parquet file" in refusal(tmp_path)


@pytest.mark.parametrize(
    ("labels", "needle"),
    [
        ("name,label_mu\nslow.csv,0.4\n", "has no column file"),
        ("file,mu\nslow.csv,0.4\n", "has unknown columns mu; it may hold file, label_mu, section, group, vehicle"),
        ("file,label_mu\nslow.csv,0,4\n", "label_mu is 0, not above 0"),
        ("file,label_mu\nslow.csv,icy\n", "line 2: label_mu is 'icy', not a number"),
        ("file,label_mu\nslow.csv,40\n", "is it per cent?"),
        ("file,label_mu\nslw.csv,0.4\n", "there is no table 'slw.csv' in"),
        ("file,label_mu\nslow.csv,0.4\nslow.csv,0.5\n", "line 3: slow.csv is named twice"),
    ],
)
def test_labels_that_cannot_be_stop_everything(tmp_path, labels, needle):
    with pytest.raises(ConfigurationError, match=r"labels\.csv") as refused:
        open_folder(write_folder(tmp_path / "drives", labels))
    assert needle in str(refused.value)


def test_a_folder_without_a_table_is_refused(tmp_path):
    (tmp_path / "labels.csv").write_text("file\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match="no recorded drives in"):
        open_folder(tmp_path)
    with pytest.raises(ConfigurationError, match="no folder or file"):
        open_folder(tmp_path / "nowhere")


def test_a_mapping_for_can_logs_is_refused(tmp_path):
    tables = "".join(
        f'[{name}]\nmessage = "A"\nsignal = "B"\nunit = "{unit}"\n'
        for name, unit in (
            *(("accel_x", "g"), ("accel_y", "g"), ("yaw_rate", "rad/s"), ("steer", "rad")),
            *((f"wheel_{where}", "m/s") for where in ("front_left", "front_right", "rear_left", "rear_right")),
        )
    )
    (tmp_path / "signals.toml").write_text(f'dbc = "car.dbc"\n{tables}', encoding="utf-8")
    with pytest.raises(ConfigurationError, match="goes with CAN logs"):
        read_as(signals=tmp_path / "signals.toml")
