"""What is inside the wheel: everything that runs, and nothing else."""

import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

pytestmark = pytest.mark.xdist_group("packaging")


@pytest.fixture(scope="module")
def names(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


@pytest.mark.parametrize("package", ["roadgrip", "rsu_app", "vehicle_client", "training"])
def test_every_module_of_the_checkout_is_in_the_wheel(names, project_root, package):
    modules = {path.relative_to(project_root).as_posix() for path in (project_root / package).rglob("*.py")}
    assert modules <= names


@pytest.mark.parametrize("package", ["roadgrip", "rsu_app", "vehicle_client", "training"])
def test_a_type_checker_may_trust_the_annotations(names, package):
    assert f"{package}/py.typed" in names


def test_the_migrations_lie_beside_the_code_that_runs_them(names, project_root):
    here = {path.relative_to(project_root).as_posix() for path in (project_root / "migrations").rglob("*.py")}
    assert here, "no migrations in the checkout"
    assert {f"rsu_app/{name}" for name in here} <= names


def test_the_default_bundle_is_inside_whole(names, project_root):
    bundle = project_root / "rsu_app" / "default_bundle"
    files = {path.relative_to(project_root).as_posix() for path in bundle.rglob("*") if path.suffix != ".pyc"}
    files = {name for name in files if (project_root / name).is_file()}
    assert any(name.endswith(".onnx") for name in files)
    assert files <= names


def test_the_roads_of_the_paper_are_inside(names):
    assert len([name for name in names if name.startswith("roadgrip/sections/") and name.endswith(".json")]) >= 3


def test_nothing_else_is_inside(names):
    places = {name.split("/")[0] for name in names}
    assert {place for place in places if not place.endswith(".dist-info")} == {
        "roadgrip",
        "rsu_app",
        "vehicle_client",
        "training",
    }
    assert not {name for name in names if "__pycache__" in name or name.endswith((".sqlite3", ".pyc"))}


def test_the_licence_and_the_readme_travel_along(wheel, names):
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in names)
    with zipfile.ZipFile(wheel) as archive:
        (path,) = (name for name in names if name.endswith(".dist-info/METADATA"))
        metadata = Parser().parsestr(archive.read(path).decode())
    assert metadata["License-Expression"] == "Apache-2.0"
    assert "roadgrip" in str(metadata.get_payload())


def test_the_example_of_a_car_is_inside(names):
    example = "vehicle_client/shell/can/example"
    assert {f"{example}/{name}" for name in ("signals.toml", "vehicle.toml", "roadgrip-example.dbc")} <= names
