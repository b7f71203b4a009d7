"""Real roads and a real drive through real processes, by the command that the documentation names."""

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def found(project_root):
    data = project_root.parent / "shared" / "data"
    if not (data / "vehicle").is_dir():
        pytest.skip("the recordings are not beside the project (../shared/data)")
    done = subprocess.run(
        [sys.executable, "-m", "deploy.demo.real_input", "--json", "--data", str(data)],
        capture_output=True,
        text=True,
        cwd=project_root,
        check=False,
        timeout=150,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_surveyed_mountain_road_is_imported_and_served(found):
    road = found["road"]
    assert road["served_version"] == road["file"]["version"]
    assert 600.0 < road["file"]["length_m"] < 625.0
    assert road["advice"]["reason"] == "winter_speed_few_vehicles"


def test_a_recorded_lap_is_found_in_the_map_made_from_another_lap(found):
    match = found["drive"]["replay"]["passage"]["match"]
    assert match["method"] == "dead_reckoning"
    assert match["confidence_frac"] > 0.9


def test_the_recorded_drive_is_acknowledged_and_honestly_called_out_of_envelope(found):
    exchange = found["drive"]["replay"]["exchange"]
    assert exchange["ending"] == "accepted"
    # A race car on a dry track: neither its driving nor its grip is what the model learned from.
    assert set(exchange["not_counted"]) == {"out_of_envelope", "estimate_out_of_range"}
    assert [passage["counted"] for passage in found["drive"]["stored"]] == [False]
