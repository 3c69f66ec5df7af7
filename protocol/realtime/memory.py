"""Measures for memory, each of which holds as long as a `with` lasts.

They yield what was done, and raise NotGrantedError.
"""

import ctypes
import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager

from protocol.realtime.rights import CAP_IPC_LOCK, NotGrantedError, capable, raise_limit

# From <sys/mman.h>.
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4


@contextmanager
def locked() -> Iterator[str]:
    """All memory in use stays in RAM: it is neither swapped, nor dropped to be read from its file
    again."""
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


@contextmanager
def frozen() -> Iterator[str]:
    """The garbage collector looks no more at what exists now.

    It goes on with what is made from now on, which is little, and so soon looked at.
    """
    gc.collect()
    gc.freeze()
    try:
        yield f"{gc.get_freeze_count()} objects out of the garbage collector's sight"
    finally:
        gc.unfreeze()
