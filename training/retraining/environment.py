"""What a retraining ran in: code, tools, machine; so that somebody can run it again."""

from __future__ import annotations

import platform
import shutil
import subprocess
from collections.abc import Mapping
from importlib.metadata import distributions, version
from pathlib import Path

import training
from training.code_identity import code_digest
from training.machine import processor_model

_PROJECT_FOLDER = Path(training.__file__).resolve().parents[1]
_ENTRY_MODULE = "training.retraining.retrain"
MODEL_REQUIREMENTS = ("numpy", "onnx", "onnxruntime", "pandas")
"""What has to be installed beside mlflow to ask a registered model."""
_GIT_TIMEOUT_S = 10.0


def code_version() -> dict[str, str]:
    """Return which code this is: a digest of what retraining reaches; in a git checkout the commit, too.

    "dirty" says whether the checkout's files differ from the commit. An installed package has no commit.
    """
    said = {"code.digest": code_digest(_ENTRY_MODULE)}
    commit = _git("rev-parse", "HEAD")
    if commit is None or _git("rev-parse", "--show-toplevel") != str(_PROJECT_FOLDER):
        return said
    changed = _git("status", "--porcelain", "--untracked-files=no")
    return said | {"code.git_commit": commit, "code.git_dirty": str(changed != "").lower()}


def environment(tools: Mapping[str, str]) -> dict[str, str]:
    """Return what this runs on.

    Args:
        tools: Versions of the tools that models are made with.
    """
    return {
        **tools,
        "platform": platform.platform(),
        "processor": processor_model(),
        "implementation": platform.python_implementation(),
        **code_version(),
    }


def requirements() -> list[str]:
    """Return everything that is installed, as pip wants it, by name."""
    installed = {each.metadata["Name"].lower(): each.version for each in distributions() if each.metadata["Name"]}
    return [f"{name}=={installed[name]}" for name in sorted(installed)]


def model_requirements() -> list[str]:
    """Return what has to be installed to ask a registered model, as pip wants it; mlflow names itself."""
    return [f"{name}=={version(name)}" for name in MODEL_REQUIREMENTS]


def _git(*words: str) -> str | None:
    """Return what git says of the project's folder; None without git, or without a checkout there."""
    program = shutil.which("git")
    if program is None:
        return None
    try:
        done = subprocess.run(  # noqa: S603 - fixed words, and the git of this machine
            [program, "-C", str(_PROJECT_FOLDER), *words],
            capture_output=True,
            text=True,
            check=False,
            timeout=_GIT_TIMEOUT_S,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None
