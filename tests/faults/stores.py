"""A store alone in a process of its own, for the shortest of the tests: no sockets, no model, the same disk."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path

from roadgrip.errors import StoreError
from rsu_app.adapters.store import open_store
from tests.faults.machine import Machine, take_over
from tests.faults.sabotage import break_unit
from tests.faults.units import DATABASE_NAME, fork_context
from tests.rsu_app.adapters.store.stories import make_entry

GROUP_COUNT = 4


class StoreAlone:
    """A store that is asked from outside to append passages, and killed.

    Args:
        pipe: To its process.
    """

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe

    def append(self, seeds: Sequence[int]) -> str:
        """Return an empty text after the commit that holds the passages, or why they were refused."""
        self._pipe.send(tuple(seeds))
        return str(self._pipe.recv())

    def probe(self) -> str:
        """Return an empty text if writing is known to work, or why not."""
        self._pipe.send(())
        return str(self._pipe.recv())


@contextmanager
def store_alone(machine: Machine, *, broken: str = "") -> Iterator[StoreAlone]:
    """Give a store on a machine; it is killed at the end."""
    ours, theirs = fork_context().Pipe()
    process = fork_context().Process(target=_serve, args=(theirs, machine.join(), broken))
    process.start()
    theirs.close()
    try:
        assert ours.recv() == "open"
        yield StoreAlone(ours)
    finally:
        process.kill()
        process.join()


def _serve(pipe: Connection, machine: Sequence[str], broken: str) -> None:
    take_over(*machine)
    for name in ("small log", broken):
        break_unit(name)
    asyncio.run(_answer(pipe, Path(machine[0], DATABASE_NAME)))


async def _answer(pipe: Connection, database: Path) -> None:
    store = open_store(database)
    pipe.send("open")
    while True:
        seeds = await asyncio.to_thread(pipe.recv)
        try:
            if seeds:
                await store.append([make_entry(seed) for seed in seeds])
            else:
                await store.probe()
        except StoreError as error:
            pipe.send(str(error))
        else:
            pipe.send("")
