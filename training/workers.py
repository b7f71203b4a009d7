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
    # Each worker gets one thread for linear algebra: there are as many workers as there is work for.
    for name in _ONE_THREAD:
        os.environ.setdefault(name, "1")
    # Spawned, not forked: the compiled drives and the linear algebra keep threads that do not survive a fork.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers_count, mp_context=context, initializer=_end_with_parent)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _end_with_parent() -> None:
    """End this process when the one that started it is gone, killed perhaps: a pool's workers wait for ever else."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
