"""Programs that are imported once and started many times; each command still runs in a process of its own.

The laboratory's libraries take seconds to import, and an operator's year has some forty commands. So one process
imports them, and forks for every command: the child has arguments, folder, environment and output of its own, and ends
with it.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Self

PROGRAMS = {"roadgrip-train": "training.__main__", "roadgrip-rsu": "rsu_app.__main__"}
_LIBRARIES = ("training.cli", "rsu_app.cli.main", "training.tracking", "xgboost", "onnxmltools", "mlflow.tracking")
_FAILED = 70
"""Exit code of a child that ended by an exception: "internal software error" of sysexits.h."""


class WarmPrograms:
    """Runs commands of ours; use it with `with`."""

    def __enter__(self) -> Self:
        """Start importing; the first command waits for its end."""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "deploy.rehearsal.warm"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "MLFLOW_DISABLE_TELEMETRY": "true"},
            cwd=Path(__file__).parents[2],
            text=True,
            process_group=0,
        )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Let it end."""
        self._end_of(self._process.stdin).close()
        self._process.wait()
        self._end_of(self._process.stdout).close()

    def run(
        self, words: Sequence[str], *, folder: Path, environment: Mapping[str, str]
    ) -> subprocess.CompletedProcess[str]:
        """Return what came of a command.

        Args:
            words: Its program, one of `PROGRAMS`, and its arguments.
            folder: Where it is given.
            environment: Variables besides those of this process.
        """
        with tempfile.TemporaryDirectory() as outputs:
            out, err = Path(outputs) / "out", Path(outputs) / "err"
            order = {
                "words": list(words),
                "folder": str(folder.resolve()),
                "environment": dict(environment),
                "out": str(out),
                "err": str(err),
            }
            stdin = self._end_of(self._process.stdin)
            stdin.write(json.dumps(order) + "\n")
            stdin.flush()
            code = int(self._end_of(self._process.stdout).readline())
            return subprocess.CompletedProcess(list(words), code, out.read_text(), err.read_text())

    @staticmethod
    def _end_of(pipe: IO[str] | None) -> IO[str]:
        assert pipe is not None  # noqa: S101 - it was asked for
        return pipe


def serve() -> None:
    """Import everything, then run a command for every line of standard input."""
    for library in (*_LIBRARIES, *PROGRAMS.values()):
        with contextlib.suppress(ModuleNotFoundError):
            importlib.import_module(library)
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            os._exit(_ended(json.loads(line)))
        _, status = os.waitpid(child, 0)
        print(os.waitstatus_to_exitcode(status), flush=True)


def _ended(order: dict[str, object]) -> int:
    """Return the exit code of a command that runs in this process, which is the child's."""
    program, *_ = words = [str(word) for word in order["words"]]  # type: ignore[attr-defined]
    os.chdir(str(order["folder"]))
    os.environ.update({str(name): str(value) for name, value in order["environment"].items()})  # type: ignore[attr-defined]
    for path, number in ((order["out"], 1), (order["err"], 2)):
        file = os.open(str(path), os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        os.dup2(file, number)
        os.close(file)
    os.close(0)
    sys.argv = words
    try:
        importlib.import_module(PROGRAMS[program]).main()
    except SystemExit as ended:
        code = ended.code
    except BaseException:  # noqa: BLE001 - a child must not go on as its parent
        sys.excepthook(*sys.exc_info())
        code = _FAILED
    else:
        code = 0
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    return code if isinstance(code, int) else int(code is not None)


if __name__ == "__main__":
    serve()
