"""One function over many cases: on all cores of this machine, or on a Dask cluster.

Every process uses one thread for linear algebra. Matrices of a few rows gain nothing from threads,
and on a busy machine the threads wait for each other far longer than they compute.
"""

import asyncio
import atexit
import gc
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from numbers import Number
from typing import TYPE_CHECKING, Any, TypeVar, get_origin

from protocol.config.quantities import shown
from protocol.errors import ArgumentError, SweepError
from protocol.summary.fields import Summary
from protocol.summary.figures import figures
from telepulse.columns import data_frame

if TYPE_CHECKING:
    import pandas as pd

Case = TypeVar("Case")
Result = TypeVar("Result")
CONNECT_S = 10
# OpenBLAS and similar libraries read it only when they are loaded, so new processes are needed.
THREADS = "OMP_NUM_THREADS"
# Each worker imports the program, and would begin the sweep again.
DIED = (
    "a worker process died: for lack of memory, or because the program calls sweep outside of"
    """ `if __name__ == "__main__":`"""
)
# Characters of a case that an error shows.
CASE_SHOWN = 80


def in_one_thread(function: Callable[[Case], Result], case: Case) -> Result:
    """Call a module-level function in a new process; return its result or raise its error."""
    with _one_thread_pool(1) as pool:
        return pool.submit(function, case).result()


@contextmanager
def _one_thread_pool(processes: int) -> Iterator[Executor]:
    before = os.environ.get(THREADS)
    os.environ[THREADS] = "1"
    try:
        # A fork of a process with threads, which matplotlib and numpy may have, is not safe.
        spawn = get_context("spawn")
        with ProcessPoolExecutor(processes, spawn, initializer=_end_without_collection) as pool:
            yield pool
    finally:
        del os.environ[THREADS]
        if before is not None:
            os.environ[THREADS] = before


def _end_without_collection() -> None:
    """Let a worker end at once: to collect all objects of the compiler takes 0.3 s, for nothing."""
    atexit.register(gc.freeze)


class SweepResults(list[Result]):
    """Results of a sweep: a list in the order of the cases, which is also a table.

    Attributes
    ----------
    cases : list
        Case of each result.
    """

    def __init__(self, cases: Sequence[Any], results: Iterable[Result]) -> None:
        super().__init__(results)
        self.cases = list(cases)

    def columns(self) -> dict[str, list[Any]]:
        """Return the table by columns: first those of the cases, then those of the results.

        A case or result that is a mapping or a named tuple has a column for each of its entries. A
        run has one for each figure of its summary, by its key: "force_rmse_n.aligned". Any other
        one is the column "case" or "result"; a `Scene` is shown as text. A column of a result that
        has the name of one of the cases begins with "result.". Missing values are None.
        """
        cases = [_entries("case", case) for case in self.cases]
        named = {name for case in cases for name in case}
        rows = [
            case
            | {
                f"result.{name}" if name in named else name: value
                for name, value in _entries("result", result).items()
            }
            for case, result in zip(cases, self, strict=True)
        ]
        names = dict.fromkeys(name for row in rows for name in row)
        return {name: [row.get(name) for row in rows] for name in names}

    def to_dataframe(self) -> "pd.DataFrame":
        """Return the columns as a pandas DataFrame, one row a case.

        Raises
        ------
        OutputError
            If pandas is not installed.
        """
        return data_frame(self.columns())


def _entries(name: str, value: Any) -> dict[str, Any]:
    """Return a case or a result by columns."""
    if isinstance(summary := getattr(value, "summary", None), Summary):
        plain = summary.to_dict()
        return {
            figure.key: figure.value(plain)
            for figure in figures()
            if get_origin(figure.type) not in (dict, list)
        }
    if isinstance(value, Mapping):
        return {str(key): each for key, each in value.items()}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return dict(value._asdict())
    return {name: value if isinstance(value, Number | str | None) else str(value)}


def sweep(
    function: Callable[[Case], Result], cases: Iterable[Case], scheduler: str | None = None
) -> SweepResults[Result]:
    """Return the function's result for each case, in the order of the cases, as list and table.

    Parameters
    ----------
    function
        A pure module-level function, which other processes can import.
    cases
        Arguments of the function, one for each case. Errors name a case by the begin of its `str`.
    scheduler
        Address of a Dask scheduler such as `tcp://HOST:8786`, whose workers have this version
        of telepulse. Without one, all cores of this machine are used; the results are the same.

    Returns
    -------
    SweepResults
        A list; `to_dataframe` and `columns` return cases and results as a table.

    Raises
    ------
    ArgumentError
        If `cases` cannot be iterated over.
    SweepError
        A case failed; cases that have not begun are not run. Or the cluster cannot be used.

    Notes
    -----
    Each worker process imports the program that calls this function. So the call of a program is
    within `if __name__ == "__main__":`.

    Examples
    --------
    >>> import math
    >>> if __name__ == "__main__":  # doctest: +SKIP
    ...     print(telepulse.sweep(math.sqrt, [4, 9]))
    [2.0, 3.0]
    """
    if not isinstance(cases, Iterable):
        raise ArgumentError(f"cases: must be a list or another iterable, got {shown(cases)}")
    cases = list(cases)
    if not cases:
        return SweepResults([], [])
    processes = min(len(cases), os.cpu_count() or 1)
    pool = _one_thread_pool(processes) if scheduler is None else _cluster(scheduler)
    with pool as workers:
        jobs = list[Future[Result]]()
        try:
            jobs += [workers.submit(function, case) for case in cases]
            results = [_result(job, case) for job, case in zip(jobs, cases, strict=True)]
            return SweepResults(cases, results)
        except BrokenProcessPool:
            raise SweepError(DIED) from None
        finally:
            for job in jobs:
                job.cancel()


def _result(job: Future[Result], case: object) -> Result:
    try:
        return job.result()
    except BrokenProcessPool:
        raise SweepError(f"{_short(case)}: {DIED}") from None
    except CancelledError:
        raise SweepError(f"{_short(case)}: the connection to the Dask scheduler was lost") from None
    except Exception as error:
        raise SweepError(f"{_short(case)}: {type(error).__name__}: {error}") from error


def _short(case: object) -> str:
    text = str(case)
    return text if len(text) <= CASE_SHOWN else f"{text[:CASE_SHOWN]}…"


@contextmanager
def _cluster(scheduler: str) -> Iterator[Executor]:
    """Yield the workers of a cluster; Dask itself gives each one thread of linear algebra."""
    try:
        from distributed import Client
    except ImportError:
        raise SweepError(
            "a sweep on a cluster needs Dask: pip install 'telepulse[cluster]'"
        ) from None
    try:
        asyncio.run(_check_reachable(scheduler))
    except (OSError, ValueError) as error:
        raise SweepError(f"{scheduler}: no Dask scheduler answers: {error}") from None
    with Client(scheduler, timeout=CONNECT_S, set_as_default=False) as client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError:
            raise SweepError(
                f"{scheduler}: no worker has joined; start one: dask worker {scheduler}"
            ) from None
        yield client.get_executor(pure=False)


async def _check_reachable(scheduler: str) -> None:
    """Raise where the scheduler cannot be reached: a Dask client would retry in the background."""
    from distributed import Security, connect

    arguments = Security().get_connection_args("client")
    comm = await connect(scheduler, timeout=CONNECT_S, **arguments)
    await comm.close()
