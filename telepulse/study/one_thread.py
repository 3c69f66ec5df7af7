"""A process for measurements that threads of a linear-algebra library would disturb."""

import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

Argument = TypeVar("Argument")
Result = TypeVar("Result")
# Read once by OpenBLAS and its like, when they are loaded: hence a process of its own.
THREADS = "OMP_NUM_THREADS"


def in_one_thread(function: Callable[[Argument], Result], argument: Argument) -> Result:
    """Call a function of a module in a fresh process whose linear algebra has one thread.

    Matrices of a few rows gain nothing from threads, and on a busy machine the threads wait for
    each other far longer than they work. What the function raises is raised here.
    """
    before = os.environ.get(THREADS)
    os.environ[THREADS] = "1"
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            return pool.submit(function, argument).result()
    finally:
        del os.environ[THREADS]
        if before is not None:
            os.environ[THREADS] = before
