"""A process for measurements that threads of a linear-algebra library would disturb."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

Argument = TypeVar("Argument")
Result = TypeVar("Result")
# Read once by OpenBLAS and its like, when they are loaded: hence processes of their own.
THREADS = "OMP_NUM_THREADS"


def in_one_thread(function: Callable[[Argument], Result], argument: Argument) -> Result:
    """Call a function of a module in a fresh process whose linear algebra has one thread.

    Matrices of a few rows gain nothing from threads, and on a busy machine the threads wait for
    each other far longer than they work. What the function raises is raised here.
    """
    with one_thread_pool(1) as pool:
        return pool.submit(function, argument).result()


@contextmanager
def one_thread_pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    """Fresh processes whose linear algebra has one thread each."""
    before = os.environ.get(THREADS)
    os.environ[THREADS] = "1"
    try:
        # A fork of a process with threads, which matplotlib and numpy may have, is not safe.
        with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
            yield pool
    finally:
        del os.environ[THREADS]
        if before is not None:
            os.environ[THREADS] = before
