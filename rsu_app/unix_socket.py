"""Names of Unix sockets that are longer than the kernel takes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

NAME_LIMIT_BYTES = 107
"""Linux has room for 108 bytes, the zero at the end among them."""


@contextmanager
def socket_name(path: Path) -> Iterator[str]:
    """Give a name by which a socket can be bound or found while the context lasts, however deep its folder lies.

    A folder that is open has a short name of its own under /proc.

    Args:
        path: Where the socket's file is, or shall be.

    Raises:
        OSError: The folder cannot be opened.
    """
    if len(os.fsencode(path)) <= NAME_LIMIT_BYTES:
        yield str(path)
        return
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)
