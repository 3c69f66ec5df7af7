"""A node's request for short time slices, read back from the kernel in a process of its own."""

import platform
import re
import sys

import pytest

from tests.support.nodes import run_python

CODE = """
import pathlib, threading
from protocol.host.process import request_short_slices
request_short_slices()
later = threading.Thread(target=lambda: print(pathlib.Path("/proc/thread-self/sched").read_text()))
later.start()
later.join()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="of Linux")
def test_short_slices_are_requested_where_the_kernel_has_them() -> None:
    result = run_python("-c", CODE)
    assert (result.returncode, result.stderr) == (0, "")
    found = re.search(r"se\.slice +: +(\d+)", result.stdout)
    release = tuple(map(int, re.findall(r"\d+", platform.release())[:2]))
    if found is None or release < (6, 12):
        pytest.skip("this kernel does not show its slices, or has no others")
    assert int(found[1]) == 100_000
