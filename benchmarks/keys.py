"""Cost of keys: admission, a check of the allow-list, and frames lost to others at a revocation."""

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import zmq

from benchmarks.benchmark import Benchmark
from benchmarks.timing import time_call
from protocol import sockets
from protocol.security.allow_list import revoke
from protocol.security.authenticator import Authenticator
from protocol.security.link_keys import ClientKeys, ServerKeys
from tests.support.keyring import Keyring

FRAME_S = 0.005
ROUNDS = 10
PATIENCE_S = 10.0


class Reader:
    """A listener, and the times at which it received the numbers."""

    def __init__(self, context: sockets.Context, keys: ClientKeys, address: str) -> None:
        self.socket = sockets.connect(context, zmq.SUB, address, keys)
        self.socket.subscribe(b"")
        self.received: list[int] = []
        self.last_s = 0.0

    def read(self) -> None:
        """Receive all numbers that have arrived."""
        for message in sockets.receive_parts(self.socket):
            self.received.append(int(message))
            self.last_s = time.perf_counter()

    @property
    def missed(self) -> int:
        """Return the longest run of missing numbers."""
        return int(np.diff(self.received).max()) - 1


class Stream:
    """An authenticated PUB socket with a number every 5 ms, as frames have, and its readers."""

    def __init__(self, context: sockets.Context, keys: ServerKeys, address: str) -> None:
        self.authenticator = Authenticator(context, keys)
        self._data = sockets.bind(context, zmq.PUB, address, self.authenticator)
        self.address = self._data.getsockopt_string(zmq.LAST_ENDPOINT)
        self.readers: list[Reader] = []
        self._sent = 0

    def run_until(self, done: Callable[[], object]) -> None:
        """Send and receive."""
        end_s = next_s = time.perf_counter() + FRAME_S
        end_s += PATIENCE_S
        while not done() and time.perf_counter() < end_s:
            for reader in self.readers:
                reader.read()
            self.authenticator.poll(time.perf_counter_ns())
            if time.perf_counter() >= next_s:
                next_s += FRAME_S
                self._sent += 1
                sockets.send(self._data, b"%d" % self._sent)
            time.sleep(0.0002)


def main(benchmark: Benchmark) -> None:
    """Print the costs of a check of the list, and of a revocation for its key and for others."""
    with tempfile.TemporaryDirectory() as folder:
        keys = Keyring(Path(folder))
        keys.allow("stays")
        rows = [_revoke(keys, number / ROUNDS) for number in range(ROUNDS)]
        cost_us = _look_round_us(keys)
    columns = ("", "median", "most")
    texts = (
        "admission: from connecting to the first frame, ms",
        "revoked: from the command to its last frame, ms",
        "revoked: frames of 5 ms another reader at its address misses",
        "  the same, ms of the stream",
    )
    let_in_ms, cut_ms, missed = zip(*rows, strict=True)
    missed_ms = [frames * FRAME_S * 1e3 for frames in missed]
    table = [
        (text, f"{statistics.median(values):.0f}", f"{max(values):.0f}")
        for text, values in zip(texts, (let_in_ms, cut_ms, missed, missed_ms), strict=True)
    ]
    table.append(("a poll without connection requests, µs", f"{cost_us:.1f}", ""))
    benchmark.table(f"Keys, {ROUNDS} rounds over loopback", columns, table)


def _revoke(keys: Keyring, phase_s: float) -> tuple[float, float, int]:
    """Admit a key and revoke it.

    Returns the ms until the first frame and to the last, and the frames missed by the others.
    phase_s: time of the revocation within the second between two checks of the list.
    """
    keys.allow("goes")
    context: sockets.Context = zmq.Context()
    try:
        stream = Stream(context, keys.server(), "tcp://127.0.0.1:*")
        began_s = time.perf_counter()
        stays, goes = (
            Reader(context, keys.client(name), stream.address) for name in ("stays", "goes")
        )
        stream.readers += (stays, goes)
        stream.run_until(lambda: goes.received and stays.received)
        let_in_ms = (goes.last_s - began_s) * 1e3
        settled_s = time.perf_counter() + 0.5 + phase_s
        stream.run_until(lambda: time.perf_counter() > settled_s)
        revoke(keys.allowed, "goes")
        revoked_s = time.perf_counter()
        stream.run_until(lambda: stream.authenticator.rejected["revoked_key"])
        settled_s = time.perf_counter() + 1.0
        stream.run_until(lambda: time.perf_counter() > settled_s)
        return let_in_ms, (goes.last_s - revoked_s) * 1e3, stays.missed
    finally:
        context.destroy(linger=0)


def _look_round_us(keys: Keyring) -> float:
    context: sockets.Context = zmq.Context()
    try:
        stream = Stream(context, keys.server(), "tcp://127.0.0.1:*")
        return time_call(lambda: stream.authenticator.poll(time.perf_counter_ns()))
    finally:
        context.destroy(linger=0)
