"""A process whose next open files have numbers that `select` does not take."""

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager

# FD_SETSIZE of Linux and macOS.
SELECT_TAKES = 1_024
FILES = 4_096


@contextmanager
def many_files() -> Iterator[None]:
    """Keep the descriptors below 1 024 in use within a `with`."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(FILES, before[0]), max(FILES, before[1])))
    kept = [os.open(os.devnull, os.O_RDONLY)]
    try:
        while kept[-1] < SELECT_TAKES:
            kept.append(os.dup(kept[0]))
        yield
    finally:
        for number in kept:
            os.close(number)
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
