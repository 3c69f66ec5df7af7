"""Memory that stays in RAM, and objects that the garbage collector leaves alone."""

import ctypes
import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager

from protocol.host.scheduling import CAP_IPC_LOCK, NotGrantedError, capable, raise_limit

# From <sys/mman.h>.
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4


@contextmanager
def locked() -> Iterator[str]:
    """Keep all memory in use in RAM while the `with` lasts: it is neither swapped, nor dropped to
    be read from its file again. Yields what was done. Raises NotGrantedError."""
    import resource  # not on every system

    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if limit != resource.RLIM_INFINITY and not capable(CAP_IPC_LOCK):
        # Below the limit it would be granted, and what grows beyond it later has no memory.
        raise NotGrantedError(
            f"RLIMIT_MEMLOCK is {limit >> 10} KiB, which a node may outgrow",
            raise_limit("memlock", "unlimited", "LimitMEMLOCK=infinity", "--ulimit memlock=-1"),
        )
    libc = ctypes.CDLL(None, use_errno=True)
    # On fault: else what libraries never use is read in as well, which is four times the memory,
    # and who starts a thread fills its stack, for milliseconds.
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT):
        reason = f"mlockall: {os.strerror(ctypes.get_errno())}"
        raise NotGrantedError(reason, "Linux 4.4 and later have it")
    try:
        yield "memory in use stays in RAM"
    finally:
        libc.munlockall()


def freeze_objects() -> None:
    """Take all objects that exist out of the garbage collector (`gc.freeze`).

    Call it once before a loop, and before a drive moves: it takes some 20 ms. A full collection
    would take as long in the middle of a stream, which delays 20 samples.
    """
    gc.collect()
    gc.freeze()
