"""Children without the rights to a priority and to locked memory."""

import ctypes
import os
import resource
from subprocess import CompletedProcess

import pytest

from protocol.host.linux import CAP_IPC_LOCK, CAP_SYS_NICE
from tests.support.nodes import run_python

# From <linux/prctl.h>.
PR_CAPBSET_DROP = 24


def _may_have_priority() -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


needs_rights = pytest.mark.skipif(
    not _may_have_priority(), reason="needs the right to SCHED_FIFO, which root has"
)


def without_rights(*command: str) -> "CompletedProcess[str]":
    """Run Python as a user who may have no priority and lock no memory."""
    return run_python(*command, preexec_fn=_give_up)


def _give_up() -> None:
    for limit in (resource.RLIMIT_RTPRIO, resource.RLIMIT_MEMLOCK):
        resource.setrlimit(limit, (0, 0))
    libc = ctypes.CDLL(None)
    for capability in (CAP_SYS_NICE, CAP_IPC_LOCK):
        # It fails on a system without this capability.
        libc.prctl(PR_CAPBSET_DROP, capability, 0, 0, 0)
