"""A network namespace of our own, nameless: it goes when nothing holds it any more."""

import ctypes
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO

from protocol.errors import TelepulseError
from telepulse.emulator.tun import TUN_PATH, bring_up, open_tun

_CLONE_NEWNET = 0x40000000
_OURS = "/proc/thread-self/ns/net"
_libc = ctypes.CDLL(None, use_errno=True)


class EmulatorError(TelepulseError, OSError):
    """The link emulator cannot run here, or its relay failed.

    Example scenarios: not root, no /dev/net/tun, the relay was killed.
    """


def unavailable() -> str | None:
    """Why namespaces and TUN devices cannot be made here; None when they can."""
    if os.geteuid() != 0:
        return "the link emulator needs root"
    try:
        os.close(os.open(TUN_PATH, os.O_RDWR))
        with _and_home_again():
            _unshare()
    except OSError as error:
        return f"the link emulator needs {TUN_PATH} and network namespaces: {error.strerror}"
    return None


class Namespace:
    """A network namespace with a loopback and a TUN device at `address`.

    tun: the descriptor its packets are read from and written to.
    """

    def __init__(self, address: str) -> None:
        """Raises EmulatorError."""
        self.address = address
        try:
            with _and_home_again():
                _unshare()
                bring_up("lo")
                self.tun = open_tun("tun0", address)
                self._descriptor = os.open(_OURS, os.O_RDONLY)
        except OSError as error:
            raise EmulatorError(f"cannot make a namespace with a TUN device: {error}") from None

    def close(self) -> None:
        """Let go of it; the kernel removes it once no program runs in it any more."""
        os.close(self.tun)
        os.close(self._descriptor)

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Within, what this thread opens or starts is in the namespace, and stays there."""
        with _and_home_again():
            _check(_libc.setns(self._descriptor, _CLONE_NEWNET))
            yield

    def start(
        self,
        *command: str,
        stdout: IO[str] | int | None = None,
        stderr: IO[str] | int | None = None,
    ) -> subprocess.Popen[str]:
        """Start a program in the namespace; it is the caller's to end."""
        with self.entered():
            return subprocess.Popen(command, stdout=stdout, stderr=stderr, text=True)


@contextmanager
def _and_home_again() -> Iterator[None]:
    """Afterwards this thread is in the namespace that it was in before."""
    home = os.open(_OURS, os.O_RDONLY)
    try:
        yield
    finally:
        _check(_libc.setns(home, _CLONE_NEWNET))
        os.close(home)


def _unshare() -> None:
    _check(_libc.unshare(_CLONE_NEWNET))


def _check(outcome: int) -> None:
    if outcome:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
