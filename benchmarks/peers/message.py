"""Interface of every peer's publisher and subscriber."""

import struct
from typing import NamedTuple

VALUE = 0.5
FIELDS = struct.Struct("<qqf")
"""Number, time in ns and one sample, for peers without a format of their own."""


class Keys(NamedTuple):
    """CURVE keys of both ends, as `zmq.curve_keypair` returns them."""

    server_public: bytes
    server_secret: bytes
    client_public: bytes
    client_secret: bytes


class Wire(NamedTuple):
    """The address of both processes: a port of 127.0.0.1 and the next one; keys if encrypted."""

    port: int
    keys: Keys | None


class Arrival(NamedTuple):
    """A message: its number, the time before encoding, the time when its value could be used.

    Both times are of CLOCK_MONOTONIC, which processes of one machine share.
    """

    sequence: int
    sent_ns: int
    usable_ns: int
