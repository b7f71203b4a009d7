"""Build the wheel once, and make empty environments to install it into.

All tests of this folder run in one worker (`xdist_group`), since the wheel and the environments are what takes time.
"""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

NO_NETWORK = re.compile(
    r"dns error|error sending request|failed to lookup|connection (refused|reset)|timed out", re.IGNORECASE
)


@dataclass(frozen=True)
class Environment:
    """A virtual environment that holds the wheel and one role's dependencies, and nothing of the checkout."""

    folder: Path

    def program(self, name: str) -> str:
        return str(self.folder / "bin" / name)

    def run(self, *command: str, cwd: Path, timeout_s: float = 120.0) -> subprocess.CompletedProcess[str]:
        """Run a program of the environment as a stranger would: elsewhere, and with a bare environment."""
        return subprocess.run(
            [self.program(command[0]), *command[1:]],
            cwd=cwd,
            env=bare_environ(),
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )

    def python(self, code: str, *, cwd: Path) -> str:
        """Run a piece of Python with warnings as they come; return what it prints."""
        done = self.run("python", "-c", code, cwd=cwd)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


def bare_environ() -> dict[str, str]:
    """Return the environment variables of this process that cannot lead back into the checkout."""
    return {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "ROADGRIP", "VIRTUAL_ENV"))
    }


def uv(*arguments: str, cwd: Path) -> None:
    """Run uv; skip where the registry cannot be reached, except in continuous integration, which must reach it."""
    find_uv_bin = pytest.importorskip("uv", reason="the environment was set up by pip alone").find_uv_bin
    done = subprocess.run([find_uv_bin(), *arguments], cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode != 0 and NO_NETWORK.search(done.stderr) and not os.environ.get("CI"):
        pytest.skip(f"the package registry cannot be reached: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, f"uv {' '.join(arguments)}\n{done.stderr}"


@pytest.fixture(scope="session")
def wheel(project_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", str(folder), str(project_root)],
        capture_output=True,
        text=True,
        check=True,
    )
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="session")
def locked_environment(
    wheel: Path, project_root: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], Environment]:
    """Install as an operator does: exactly the role's lock with its hashes, then the wheel without dependencies."""
    made: dict[str, Environment] = {}

    def environment(role: str) -> Environment:
        if role not in made:
            folder = tmp_path_factory.mktemp(role) / "venv"
            python = f"--python={folder / 'bin' / 'python'}"
            uv("venv", f"--python={sys.executable}", str(folder), cwd=folder.parent)
            lock = project_root / "requirements" / f"{role}.txt"
            uv("pip", "sync", python, "--require-hashes", str(lock), cwd=folder.parent)
            uv("pip", "install", python, "--offline", "--no-deps", str(wheel), cwd=folder.parent)
            made[role] = Environment(folder)
        return made[role]

    return environment


@pytest.fixture
def extra_environment(wheel: Path, project_root: Path, tmp_path: Path) -> Callable[[str], Environment]:
    """Install as a newcomer does: the wheel with an extra, whatever that asks for (in the versions we lock)."""

    def environment(extra: str) -> Environment:
        folder = tmp_path / "venv"
        uv("venv", f"--python={sys.executable}", str(folder), cwd=tmp_path)
        python = f"--python={folder / 'bin' / 'python'}"
        constraints = f"--constraint={project_root / 'requirements' / 'dev.txt'}"
        what = f"roadgrip[{extra}] @ {wheel.as_uri()}" if extra else f"roadgrip @ {wheel.as_uri()}"
        uv("pip", "install", python, constraints, what, cwd=tmp_path)
        return Environment(folder)

    return environment
