"""Processes that drive: as many as asked for, none where one is enough, and none that outlive the one that asked."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class InThisProcess(Executor):
    """Does what is submitted at once: no start-up, no copies."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Return what the call gave; its exception is raised here, not kept."""
        future: Future[T] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


@contextmanager
def executor(workers_count: int) -> Iterator[Executor]:
    """Yield something that runs calls on so many processes; on an error what has not begun is dropped.

    Args:
        workers_count: Processes; with one it is this one.
    """
    if workers_count == 1:
        yield InThisProcess()
        return
    if _KEEPERS:
        with _KEEPERS[-1].lent(workers_count) as kept:
            yield kept
        return
    pool = _new_pool(workers_count)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def kept_workers() -> Iterator[None]:
    """Keep the processes of one `executor` for the next while this lasts: starting them takes seconds each time."""
    keeper = _Keeper()
    _KEEPERS.append(keeper)
    try:
        yield
    finally:
        _KEEPERS.remove(keeper)
        keeper.end()


class _Keeper:
    """Lends processes, one borrower at a time."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._workers_count = 0

    @contextmanager
    def lent(self, workers_count: int) -> Iterator[Executor]:
        if self._pool is None or self._workers_count < workers_count:
            self.end()
            self._pool, self._workers_count = _new_pool(workers_count), workers_count
        try:
            yield self._pool
        except BaseException:
            # What has not begun is of no use to the next borrower.
            self.end()
            raise

    def end(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None


_KEEPERS: list[_Keeper] = []


def _new_pool(workers_count: int) -> ProcessPoolExecutor:
    # Each worker gets one thread for linear algebra: there are as many workers as there is work for.
    for name in _ONE_THREAD:
        os.environ.setdefault(name, "1")
    # Spawned, not forked: the compiled drives and the linear algebra keep threads that do not survive a fork.
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers_count, mp_context=context, initializer=_end_with_parent)


def _end_with_parent() -> None:
    """End this process when the one that started it is gone, killed perhaps: a pool's workers wait for ever else."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
