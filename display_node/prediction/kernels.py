"""Compilation of the numeric kernels of prediction by numba, once on each machine.

A kernel is a function of typed loops over arrays. Its signature is stated, so that it is compiled,
or loaded from numba's cache, when its module is imported: never in the loop. The arithmetic keeps
its order (no fastmath).

numba compiles a kernel into those that call it, and does not notice a later change of one in
another module: after that, delete this package's folders __pycache__.
"""

import logging
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

from numba import njit

logger = logging.getLogger(__name__)

Kernel = TypeVar("Kernel", bound=Callable[..., Any])
# Types of numba: rows of a history, single precision, and everything else.
ROW, ROWS = "float32[::1]", "float32[:, ::1]"
FLOATS, TABLE, CUBE = "float64[::1]", "float64[:, ::1]", "float64[:, :, ::1]"
PLACES = "int64[::1]"


def kernel(signature: str) -> Callable[[Kernel], Kernel]:
    """Compile a function for a signature of numba, such as "void(float64[::1], int64)".

    The first kernel that is not in the cache is named in the log: the others take some seconds.
    """

    def compiled(function: Kernel) -> Kernel:
        def compile_it(kept: bool) -> Any:
            return njit(signature, cache=kept, nogil=True, error_model="numpy")(function)

        try:
            dispatcher, kept = compile_it(kept=True), True
        except RuntimeError:
            # numba has no folder to write its cache to.
            dispatcher, kept = compile_it(kept=False), False
        # With NUMBA_DISABLE_JIT=1 the function stays as it is, for a debugger.
        if dispatcher is not function and not (kept and dispatcher.stats.cache_hits):
            _announce(kept)
        made: Kernel = dispatcher
        return made

    return compiled


@cache
def _announce(kept: bool) -> None:
    when = "once on this machine" if kept else "at each start: no folder is free for a cache"
    logger.info(f"compiling the kernels of the prediction, {when}; this takes about 10 s")


@kernel("float64(float64, float64, float64)")
def bounded(value: float, low: float, high: float) -> float:
    """Return a value within bounds; one that is no number stays one."""
    if value < low:
        return low
    return high if value > high else value
