"""How the simulator is compiled, and how its cache notices every edit.

numba keeps compiled code beside the sources (or where `NUMBA_CACHE_DIR` points), but for a cached function it watches
the file of that function alone: an edit in a function it calls would go unnoticed. So only the outermost function is
cached, and it carries the digest of everything it calls as a closure variable, which is part of numba's cache key.
The digest is taken from the loaded byte code; no file is read.
"""

from __future__ import annotations

import hashlib
from types import CodeType, FunctionType
from typing import TYPE_CHECKING, Any, TypeVar

import numba

if TYPE_CHECKING:
    from collections.abc import Callable

_Function = TypeVar("_Function", bound="Callable[..., Any]")

INTERPRETED: bool = bool(numba.config.DISABLE_JIT)
"""Whether numba was told to compile nothing, as for measuring which lines the tests reach."""

# Contraction and reciprocals are worth a fifth of the time. Reassociation and the assumption that nothing is NaN are
# not allowed: the first moves results between compilers, the second hides a run that blew up.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "arcp", "nsz"}, "nogil": True}


def kernel(function: _Function) -> _Function:
    """Return a function compiled, for loops over lanes or wheels and whatever calls them."""
    compiled: _Function = numba.njit(**_OPTIONS)(function)
    return compiled


def formula(function: _Function) -> _Function:
    """Return a function compiled into whoever calls it, for what is computed inside such a loop.

    Without branches and calls left in it, the loop works on a vector of cars per instruction.
    """
    compiled: _Function = numba.njit(forceinline=True, **_OPTIONS)(function)
    return compiled


def cached_kernel(function: _Function) -> _Function:
    """Return a function compiled and kept on disk, for the outermost one."""
    compiled: _Function = numba.njit(cache=True, **_OPTIONS)(function)
    return compiled


def code_digest(function: Any) -> int:
    """Return a number that changes with the code of a function, of whatever it calls, and of the numbers they use.

    Args:
        function: Compiled or plain. Globals that are functions, numbers, strings or tuples are followed; records that
            are arguments are not, since they enter at run time.
    """
    digest = hashlib.sha256()
    _digest_function(digest, function, set())
    return int.from_bytes(digest.digest()[:7], "big")


def _digest_function(digest: Any, function: Any, seen: set[int]) -> None:
    plain = getattr(function, "py_func", function)
    if id(plain) in seen:
        return
    seen.add(id(plain))
    _digest_code(digest, plain.__code__)
    for name in sorted(_names(plain.__code__)):
        value = plain.__globals__.get(name)
        if isinstance(getattr(value, "py_func", value), FunctionType):
            digest.update(name.encode())
            _digest_function(digest, value, seen)
        elif isinstance(value, int | float | str | tuple):
            digest.update(f"{name}={value!r};".encode())
        elif isinstance(value, type) and issubclass(value, tuple):
            # A record: compiled code knows its fields by their order.
            digest.update(f"{name}={getattr(value, '_fields', ())!r};".encode())


def _digest_code(digest: Any, code: CodeType) -> None:
    digest.update(code.co_code)
    digest.update(repr((code.co_names, code.co_varnames)).encode())
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            _digest_code(digest, constant)
        else:
            digest.update(repr(constant).encode())


def _names(code: CodeType) -> set[str]:
    names = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names |= _names(constant)
    return names
