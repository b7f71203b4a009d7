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


@cache
def function_digest(module: str, name: str) -> str:
    """Return sixteen hexadecimal characters that change with what a function of a module can reach.

    That is less than its whole module: what stands beside it there and is neither used by it nor by what it uses, such
    as a text about its results, does not count. Statements of the module that are no definitions always count.

    Args:
        module: Full name of the module.
        name: A name at its top: a function or class, or anything bound there.
    """
    path = _source_of(module)
    if path is None:
        return code_digest(module)
    reached = _reached(ast.parse(path.read_text(encoding="utf-8")), name)
    digest = hashlib.sha256(name.encode())
    for node in reached:
        digest.update(f"{ast.dump(node)}\n".encode())
    imported = sorted({name for node in reached for name in _imported(node)})
    digest.update(code_digest(*imported).encode())
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
        waiting += _imported(found[name])
    return found


def _imported(tree: ast.AST) -> list[str]:
    """Return what the imports in a tree may name."""
    names: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            # `from package import module` names a module, `from module import thing` does not: both are tried.
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return names


def _reached(tree: ast.Module, name: str) -> list[ast.stmt]:
    """Return the statements at the top of a module that a name at its top can reach, in their order."""
    reached = [not _bound(node) and not _is_text(node) for node in tree.body]
    waiting = [name, *(used for node, there in zip(tree.body, reached, strict=True) if there for used in _used(node))]
    seen: set[str] = set()
    while waiting:
        wanted = waiting.pop()
        if wanted in seen:
            continue
        seen.add(wanted)
        for i, node in enumerate(tree.body):
            if wanted in _bound(node):
                reached[i] = True
                waiting += _used(node)
    return [_narrowed(node, seen) for node, there in zip(tree.body, reached, strict=True) if there]


def _narrowed(node: ast.stmt, names: set[str]) -> ast.stmt:
    """Return an import of only those names; any other statement as it is."""
    if isinstance(node, ast.ImportFrom) and node.module != "__future__":
        kept = [alias for alias in node.names if (alias.asname or alias.name) in names]
        return ast.ImportFrom(node.module, kept, node.level)
    return node


def _bound(node: ast.stmt) -> set[str]:
    """Return the names that a statement at the top binds; none for a statement that does something else."""
    match node:
        case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
            return {node.name}
        case ast.Import() | ast.ImportFrom():
            return {(alias.asname or alias.name).split(".", 1)[0] for alias in node.names}
        case ast.Assign():
            return {inner.id for target in node.targets for inner in ast.walk(target) if isinstance(inner, ast.Name)}
        case ast.AnnAssign(target=ast.Name() as target):
            return {target.id}
        case _:
            return set()


def _used(node: ast.stmt) -> list[str]:
    return [inner.id for inner in ast.walk(node) if isinstance(inner, ast.Name)]


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _source_of(name: str) -> Path | None:
    """Return the file of a module of ours; None for a name that is none."""
    if name.split(".", 1)[0] not in _OURS:
        return None
    try:
        spec = find_spec(name)
    except ModuleNotFoundError:  # a thing inside a module, not a module inside a package
        return None
    return Path(spec.origin) if spec is not None and spec.origin is not None else None
