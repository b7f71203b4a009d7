"""Each extra installs and imports alone: what a role does not need is not there, and nothing misses it."""

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

pytestmark = [pytest.mark.xdist_group("packaging"), pytest.mark.system, pytest.mark.timeout(300)]

VEHICLE_PURE = tuple(
    f"vehicle_client.{part}" for part in ("estimation", "mapmatch", "pipeline", "recording", "vehicle_profile")
)

# role -> what must import, all of it; what the lock must not hold.
ROLES = {
    "rsu": (("roadgrip", "rsu_app"), {"scipy", "numba", "xgboost", "sklearn", "onnx", "mlflow", "matplotlib"}),
    "vehicle": (
        ("roadgrip", *VEHICLE_PURE, "vehicle_client.shell"),
        {
            *("scipy", "numba", "fastapi", "sqlalchemy", "onnxruntime", "mlflow", "matplotlib"),
            *("asammdf", "pandas", "pyarrow"),
        },
    ),
    "vehicle-files": (
        ("roadgrip", *VEHICLE_PURE, "vehicle_client.shell"),
        {"scipy", "numba", "fastapi", "sqlalchemy", "onnxruntime", "mlflow", "matplotlib"},
    ),
    "training": (
        ("roadgrip", "rsu_app.domain", *VEHICLE_PURE, "vehicle_client.simulator", "training"),
        {"can", "asammdf", "structlog", "uvloop"},
    ),
}
EXTRAS = {
    "": (("roadgrip",), {"typer", "scipy", "fastapi"}),
    "sim": (("roadgrip", *VEHICLE_PURE, "vehicle_client.simulator"), {"fastapi", "sqlalchemy", "xgboost", "typer"}),
    "demo": (("roadgrip", "rsu_app", "vehicle_client"), {"xgboost", "sklearn", "pyarrow"}),
}

QUICK = {"rsu", "vehicle", ""}
"""What runs at the roadside and in cars is tried on every change; the others' import takes up to a minute each."""
VEHICLE_LIMIT_MB = 150.0

IMPORT_ALL = """
import importlib, importlib.util, json, pkgutil, sys
failed = {}
def load(name):
    try:
        module = importlib.import_module(name)
    except Exception as error:
        failed[name] = f"{type(error).__name__}: {error}"
        return
    for found in pkgutil.iter_modules(getattr(module, "__path__", ()), name + "."):
        if not found.name.startswith("rsu_app.migrations"):  # alembic loads these, and only while migrating
            load(found.name)
for package in json.loads(sys.argv[1]):
    load(package)
there = [name for name in json.loads(sys.argv[2]) if importlib.util.find_spec(name)]
print(json.dumps([failed, there, len(sys.modules)]))
"""


def assert_imports_alone(environment, packages, absent, *, cwd: Path) -> None:
    done = environment.run(
        "python", "-c", IMPORT_ALL, json.dumps(packages), json.dumps(sorted(absent)), cwd=cwd, timeout_s=180
    )
    assert done.returncode == 0, done.stdout + done.stderr
    failed, there, _ = json.loads(done.stdout.splitlines()[-1])
    assert failed == {}
    assert there == [], "a role installs what it does not need"


def slow_ones_long(names):
    return [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in names]


@pytest.mark.parametrize("role", slow_ones_long(ROLES))
def test_a_role_imports_alone_from_its_lock(locked_environment, tmp_path, role):
    packages, absent = ROLES[role]
    assert_imports_alone(locked_environment(role), packages, absent, cwd=tmp_path)


def test_what_a_car_installs_is_small(locked_environment):
    folder = locked_environment("vehicle").folder
    size_mb = sum(path.lstat().st_size for path in folder.rglob("*")) / 1e6
    assert size_mb < VEHICLE_LIMIT_MB


def requirements_of(project: dict[str, Any], extra: str) -> set[Requirement]:
    """Return what an extra asks for here, the core and the extras it names in turn included."""
    asked: set[Requirement] = {Requirement(line) for line in project["dependencies"]}
    for requirement in map(Requirement, project["optional-dependencies"][extra]):
        if requirement.name == project["name"]:
            asked |= {one for other in requirement.extras for one in requirements_of(project, other)}
        elif requirement.marker is None or requirement.marker.evaluate():
            asked.add(requirement)
    return asked


@pytest.mark.parametrize("role", ROLES)
def test_a_lock_satisfies_what_its_extra_asks_for(project_root, role):
    project = tomllib.loads((project_root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pins = [
        Requirement(line.removesuffix("\\").strip())
        for line in (project_root / "requirements" / f"{role}.txt").read_text(encoding="utf-8").splitlines()
        if "==" in line and not line.startswith((" ", "#"))
    ]
    here = {
        pin.name: str(pin.specifier).removeprefix("==") for pin in pins if pin.marker is None or pin.marker.evaluate()
    }
    unsatisfied = {
        str(asked)
        for asked in requirements_of(project, role)
        if asked.name not in here or not asked.specifier.contains(here[asked.name])
    }
    assert not unsatisfied


@pytest.mark.parametrize("extra", slow_ones_long(EXTRAS))
def test_an_extra_imports_alone(extra_environment, tmp_path, extra):
    packages, absent = EXTRAS[extra]
    assert_imports_alone(extra_environment(extra), packages, absent, cwd=tmp_path)


@pytest.mark.parametrize(
    ("role", "script"),
    [
        ("rsu", "roadgrip-rsu"),
        ("vehicle", "roadgrip-vehicle"),
        pytest.param("training", "roadgrip-train", marks=pytest.mark.long),
    ],
)
def test_the_console_script_of_a_role_explains_itself(locked_environment, tmp_path, role, script):
    done = locked_environment(role).run(script, "--help", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Usage" in done.stdout
