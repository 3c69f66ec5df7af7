"""Take from Python what another platform lacks, as far as Linux permits; for processes of tests.

`TELEPULSE_TEST_PLATFORM` is win32 or darwin. The lists are those of Python's documentation
("Availability: Unix", "not Windows", "Linux"). The standard library itself keeps what it imported.
What the platform's own kernel would do differently is not modelled: consoles, signals, file modes.
"""

import importlib
import importlib.abc
import io
import os
import platform
import select
import shutil
import signal
import socket
import sys
import tempfile
import time
from typing import Any

PLATFORM = os.environ.get("TELEPULSE_TEST_PLATFORM", "")
# These choose by the platform what they use, and keep what is there. Ours come later.
IMPORTED_BEFORE = """
    asyncio concurrent.futures.process ctypes.util logging.handlers multiprocessing.connection
    platform shutil ssl subprocess tempfile threading uuid webbrowser urllib.request ifaddr
    matplotlib.figure numba numpy.testing prometheus_client psutil pydantic rich.console
    scipy.signal serial serial.tools.list_ports typer typer.testing zmq
"""
MISSING_MODULES = {
    "win32": "curses fcntl grp posix pty pwd readline resource syslog termios tty",
    "darwin": "spwd",
}
# The beginnings of names.
MISSING = {
    "win32": {
        os: """
            sched_ SCHED_ chown fchmod fchown fork get_blocking getegid geteuid getgid getgroups
            getloadavg getpgid getpgrp getpriority getresuid getsid getuid killpg lockf mkfifo mknod
            nice openpty pipe2 posix_ pread pwrite sendfile set_blocking setpgid setpriority setsid
            statvfs sysconf tcgetpgrp ttyname uname wait3 wait4 waitid WNOWAIT O_ASYNC O_CLOEXEC
            O_DIRECTORY O_NOCTTY O_NOFOLLOW O_NONBLOCK O_SYNC
        """,
        select: "poll epoll EPOLL POLL PIPE_BUF",
        signal: """
            SIGALRM SIGBUS SIGCHLD SIGCONT SIGHUP SIGPIPE SIGPROF SIGQUIT SIGSTOP SIGTSTP SIGTT
            SIGUSR SIGXCPU SIGRT alarm pause pthread_ setitimer siginterrupt sigpending sigtimedwait
            sigwait
        """,
        socket: """
            AF_UNIX AF_CAN AF_NETLINK AF_PACKET MSG_DONTWAIT SO_REUSEPORT SO_BINDTODEVICE CMSG_ SCM_
        """,
        time: "clock_ CLOCK_ pthread_ tzset",
    },
    "darwin": {
        os: """
            sched_ SCHED_ memfd_create pipe2 eventfd O_DIRECT O_TMPFILE O_PATH getresuid
            posix_fadvise sendfile
        """,
        select: "epoll EPOLL",
        signal: "SIGRT sigtimedwait sigwaitinfo",
        socket: """
            AF_CAN AF_NETLINK AF_PACKET SO_BINDTODEVICE SOCK_NONBLOCK SOCK_CLOEXEC TCP_USER_TIMEOUT
            TCP_KEEPIDLE TCP_INFO
        """,
        time: "CLOCK_BOOTTIME CLOCK_TAI pthread_",
    },
}


class _Finder(importlib.abc.MetaPathFinder):
    """Finder that has no module of another platform."""

    def find_spec(self, name: str, *_: object) -> None:
        if name in MISSING_MODULES[PLATFORM].split():
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def _without_kernel_files(function: Any) -> Any:
    """Return a function of paths that finds nothing below /proc and /sys."""

    def found(path: Any = ".", *arguments: Any, **options: Any) -> Any:
        if isinstance(path, str | os.PathLike) and os.fspath(path).startswith(("/proc", "/sys")):
            raise FileNotFoundError(2, os.strerror(2), os.fspath(path))
        return function(path, *arguments, **options)

    return found


def become(name: str) -> None:
    """Take away what the platform lacks."""
    for module, names in MISSING[name].items():
        prefixes = tuple(names.split())
        for attribute in [key for key in vars(module) if key.startswith(prefixes)]:
            delattr(module, attribute)
    for missing in MISSING_MODULES[name].split():
        sys.modules.pop(missing, None)
    sys.meta_path.insert(0, _Finder())
    sys.platform = name
    # Chosen when shutil is imported: Windows opens no folder.
    vars(tempfile)["_O_TMPFILE_WORKS"] = False
    vars(shutil)["_use_fd_functions"] = name != "win32"
    system = {"win32": "Windows", "darwin": "Darwin"}[name]
    platform.system = lambda: system
    for owner, function in (
        (io, "open"),
        (os, "listdir"),
        (os, "scandir"),
        (os, "open"),
        (os, "stat"),
    ):
        setattr(owner, function, _without_kernel_files(getattr(owner, function)))


if PLATFORM:
    for used in IMPORTED_BEFORE.split():
        importlib.import_module(used)
    become(PLATFORM)
