"""Ticks and events of one session of a recording, on the sensing clock."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from protocol.errors import SourceError
from telepulse.record.listener import Listener
from telepulse.record.reader import RecordingReader
from telepulse.record.schema import EVENT, TICK


@dataclass(frozen=True, slots=True)
class Felt:
    """Force felt at instants of the sensing clock, in order; events with theirs.

    sensing_minus_unix_ns: brings Unix time to the sensing clock, as at the session's first tick.
    """

    t_ns: NDArray[np.int64]
    force_n: NDArray[np.float64]
    events: list[tuple[int, str]]
    sensing_minus_unix_ns: int

    def unix_ns(self, sensing_ns: int) -> int:
        """Unix time of an instant of the sensing clock."""
        return sensing_ns - self.sensing_minus_unix_ns


def felt_in(path: Path, session: int) -> Felt:
    """Follow the clock through a recording. Raises SourceError."""
    listener, apart_ns = Listener(), 0
    t_ns: list[int] = []
    force_n: list[float] = []
    events: list[tuple[int, str]] = []
    # Before the clock is known.
    early: list[tuple[int, str]] = []
    receiver = listener.receiver
    try:
        for message in RecordingReader(path):
            fields = message.fields
            if message.topic == TICK:
                if receiver.session != session or not receiver.clock.ready:
                    continue
                sensing_ns = receiver.clock.remote_ns(fields["now_ns"])
                if not t_ns:
                    apart_ns = sensing_ns - message.t_ns
                    events += [(at_ns + apart_ns, text) for at_ns, text in early]
                unix_minus_display_ns = message.t_ns - fields["now_ns"]
                t_ns.append(sensing_ns)
                force_n.append(float(fields.get("felt_n", math.nan)))
                listener.play(fields["instant_ns"])
            elif message.topic != EVENT:
                listener.take(message.topic, fields)
            elif receiver.session == session:
                text = f"{fields['name']}: {fields['message']}"
                if t_ns:
                    at_ns = receiver.clock.remote_ns(message.t_ns - unix_minus_display_ns)
                    events.append((at_ns, text))
                else:
                    early.append((message.t_ns, text))
        times_ns = np.array(t_ns, np.int64)
    except (LookupError, ValueError, TypeError, ArithmeticError) as error:
        raise SourceError(f"{path}: a message is not telepulse's: {error!r:.80}") from None
    if not t_ns:
        raise SourceError(f"{path}: holds no tick while the sensing clock was known")
    order = np.argsort(times_ns, kind="stable")
    return Felt(times_ns[order], np.array(force_n)[order], events, apart_ns)
