"""Which code a data set came from, so that runs of yesterday's code are never taken for today's."""

from __future__ import annotations

import ast
import hashlib
from functools import cache
from importlib.util import find_spec
from pathlib import Path

_OURS = ("roadgrip", "rsu_app", "vehicle_client", "training")


@cache
def code_digest(*names: str) -> str:
    """Return sixteen hexadecimal characters that change with the code of modules and of all of ours they import.

    Comments and layout do not count. Libraries do not either: their versions stand in a bundle's provenance.

    Args:
        names: Full names of the modules to start from.
    """
    digest = hashlib.sha256()
    for name, tree in sorted(sources_of(names).items()):
        digest.update(f"{name}\n{ast.dump(tree)}\n".encode())
    return digest.hexdigest()[:16]


def sources_of(names: tuple[str, ...]) -> dict[str, ast.Module]:
    """Return the syntax trees of modules and of everything of ours that they import, directly or not."""
    found: dict[str, ast.Module] = {}
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        path = None if name in found else _source_of(name)
        if path is None:
            continue
        found[name] = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(found[name]):
            if isinstance(node, ast.Import):
                waiting += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                # `from package import module` names a module, `from module import thing` does not: both are tried.
                waiting += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return found


def _source_of(name: str) -> Path | None:
    """Return the file of a module of ours; None for a name that is none."""
    if name.split(".", 1)[0] not in _OURS:
        return None
    try:
        spec = find_spec(name)
    except ModuleNotFoundError:  # a thing inside a module, not a module inside a package
        return None
    return Path(spec.origin) if spec is not None and spec.origin is not None else None
