"""Telling listeners that an advisory changed, in bounded memory."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Self

from roadgrip.records import AdvisoryNotice


class Subscription:
    """An endless sequence of advisory notices: the one that stands, then each later one as it comes.

    A listener that is slower than the changes skips the ones in between and gets the newest; nothing queues up.
    Waiting for the next one may be cancelled (`asyncio.wait_for(anext(subscription), ...)`) without losing any.
    Close it, or use it with `async with`, to free its place.
    """

    def __init__(self, current: Callable[[], AdvisoryNotice], on_close: Callable[[Subscription], None]) -> None:
        self._current = current
        self._on_close = on_close
        self._changed = asyncio.Event()
        self._changed.set()
        self._closed = False

    def notify(self) -> None:
        """Wake the listener: there is something new."""
        self._changed.set()

    def close(self) -> None:
        """Free the place; a listener that still waits sees the end of the sequence."""
        if not self._closed:
            self._closed = True
            self._changed.set()
            self._on_close(self)

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> AdvisoryNotice:
        await self._changed.wait()
        if self._closed:
            raise StopAsyncIteration
        self._changed.clear()
        return self._current()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()
