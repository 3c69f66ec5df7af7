"""Looking up the number behind an address's name, beside the loop.

ZeroMQ looks names up in the thread that moves all its messages, and a slow name server holds that
up for seconds. So a thread of ours looks them up, which lives only while it does; ZeroMQ is given
numbers.
"""

import socket
import threading
import time
from collections.abc import Callable

LOOK_UP_AGAIN_S = 2.0


class Lookup:
    """Finds the number behind an address's name, beside the loop."""

    def __init__(self, address: str, log: Callable[[str], None]) -> None:
        self._address = address
        self._log = log
        self._said = ""
        self._lookups = 0
        self._found: str | None = None
        self._thread: threading.Thread | None = None

    @property
    def running(self) -> bool:
        """True while a look-up is under way."""
        return self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """Look up; the outcome is there when `running` ends."""
        # A daemon: a name server that does not answer must not hold up the program's end.
        self._thread = threading.Thread(target=self._run, daemon=True)
        try:
            self._thread.start()
        except RuntimeError:
            # No thread is to be had: the loop goes on, and asks again.
            self._say(f"{self._address} cannot be looked up: no thread can be started; trying on")

    def take(self) -> str | None:
        """The address with a number for a name, once for each look-up that found one."""
        found, self._found = self._found, None
        return found

    def _run(self) -> None:
        if not self._address.startswith("tcp://"):
            self._found = self._address
            return
        host, _, port = self._address.removeprefix("tcp://").rpartition(":")
        try:
            found = socket.getaddrinfo(host.strip("[]"), port, type=socket.SOCK_STREAM)
        except OSError as error:
            self._say(f"{host} is not found: {error.strerror}; trying on")
            time.sleep(LOOK_UP_AGAIN_S)
            return
        # A name may stand for several numbers, not all of them reachable: one after the other.
        numbers = sorted({(family != socket.AF_INET, name[0]) for family, *_, name in found})
        is_ipv6, number = numbers[self._lookups % len(numbers)]
        self._lookups += 1
        number = f"[{number}]" if is_ipv6 else number
        self._found = f"tcp://{number}:{port}"

    def _say(self, text: str) -> None:
        if text != self._said:
            self._said = text
            self._log(text)
