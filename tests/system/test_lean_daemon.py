"""What a running unit carries: a module that is loaded once stays in its memory for years."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import BinaryIO

from tests.system.daemons import Daemon, Process

CARRIED_FOR_NOTHING = (
    # Migrations are run by a process that ends.
    {"alembic", "mako"},
    # Commands and pictures for a terminal.
    {"typer", "rich", "pygments", "matplotlib"},
    # Signatures and TLS, until somebody names a key.
    {"cryptography"},
    # Signed updates, until somebody names a repository.
    {"tuf", "securesystemslib", "requests", "urllib3"},
    # The laboratory, and the other end of the air.
    {"training", "vehicle_client", "scipy", "numba", "pandas", "xgboost", "sklearn", "mlflow", "onnx"},
    # An object-relational mapper, test tools, building.
    {"unittest", "doctest", "pydoc", "setuptools", "pip"},
)
PROGRAM = """
import atexit, sys
from pathlib import Path
names = Path(sys.argv.pop(1))
atexit.register(lambda: names.write_text("\\n".join(sys.modules)))
from rsu_app.__main__ import main
main()
"""


class TellingDaemon(Daemon):
    """A unit that writes down, when it ends, which modules it has loaded."""

    def begin(self, sink: BinaryIO) -> Process:
        command = [sys.executable, "-c", PROGRAM, str(self.folder / "modules"), "serve", "--config", str(self.config)]
        return subprocess.Popen(command, stdout=sink, stderr=subprocess.STDOUT)


def test_a_unit_carries_nothing_that_it_does_not_use(tmp_path: Path) -> None:
    with TellingDaemon(tmp_path) as daemon:
        assert daemon.client.get("/health/ready").status_code in {200, 503}
        assert daemon.client.get("/metrics").status_code == 200
        assert daemon.stop() == 0
    loaded = (tmp_path / "modules").read_text(encoding="utf-8").splitlines()
    assert {"onnxruntime", "sqlalchemy", "rsu_app.service"} <= set(loaded)
    carried = {name for name in loaded if name.split(".")[0] in set().union(*CARRIED_FOR_NOTHING)}
    assert carried == set()
    assert "sqlalchemy.orm" not in loaded
    commands = {name for name in loaded if name.startswith("rsu_app.cli.")}
    assert commands == {"rsu_app.cli.serving"}
