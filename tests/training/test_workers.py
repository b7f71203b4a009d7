"""Processes are kept from one to the next where that is asked for, and none outlives the asking."""

import os

import pytest

from training.workers import executor, kept_workers


def place(_number):
    return os.getpid()


def places(workers_count):
    with executor(workers_count) as pool:
        return {done.result() for done in [pool.submit(place, number) for number in range(8)]}


def test_one_worker_is_this_process():
    with kept_workers():
        assert places(1) == {os.getpid()}


@pytest.mark.system
def test_processes_are_kept_for_the_next_and_end_with_the_keeping():
    with kept_workers():
        first = places(2)
        with executor(2) as pool:
            again = pool.submit(place, 0).result()
    assert os.getpid() not in first
    assert again in first
    with pytest.raises(RuntimeError):
        pool.submit(place, 0)


def places_until_it_fails():
    with executor(2) as pool:
        pool.submit(divmod, 1, 0).result()


@pytest.mark.system
def test_who_fails_leaves_nothing_behind_for_the_next():
    with kept_workers():
        with pytest.raises(ZeroDivisionError):
            places_until_it_fails()
        with executor(2) as pool, pytest.raises(ZeroDivisionError):
            pool.submit(divmod, 1, 0).result()
        assert os.getpid() not in places(2)
