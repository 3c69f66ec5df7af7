"""Errors that a user can see, and the causes by which refused messages and peers are counted.

`TelepulseError` catches all errors.
"""

from collections.abc import Mapping


class TelepulseError(Exception):
    """Base of all errors that telepulse raises deliberately."""


class SceneError(TelepulseError, ValueError):
    """A scene cannot be used.

    Example scenarios: an unknown key, a length given in newtons, a value out of range,
    a missing file.
    """


class WireError(TelepulseError, ValueError):
    """Bytes from a peer are not a valid message; `cause` is the name under which it is counted.

    Example scenarios: not msgpack, truncated, another protocol version, a NaN sample.
    """

    def __init__(self, cause: str, message: str) -> None:
        super().__init__(message)
        self.cause = cause


class AddressError(TelepulseError, OSError):
    """A ZeroMQ address cannot be used.

    Example scenarios: the port is taken, the address has no port, the host is unknown.
    """


class KeyFileError(TelepulseError, ValueError):
    """A key file or an allow-list cannot be read, used or written.

    Example scenarios: others may read the secret key, a public key where the secret one is meant,
    a name that is not on the list.
    """


class ProtectionError(TelepulseError, ValueError):
    """A link cannot be protected as required.

    Example scenarios: an address beyond this machine without keys, a key without a peer.
    """


class SourceError(TelepulseError, OSError):
    """A source of samples cannot be opened or read.

    Example scenarios: a missing recording, a column that is not there, a file with no numbers.
    """


class DriveError(TelepulseError, OSError):
    """A drive cannot be reached, refuses, or has failed; `kind` is the fault's short name.

    Example scenarios: no such port, no answer, a wrong checksum, over-temperature, the home
    switch was not found.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


class OutputError(TelepulseError, OSError):
    """A result cannot be written.

    Example scenarios: the folder does not exist, the disk is full.
    """


class SidecarError(TelepulseError, OSError):
    """A process beside a node cannot start.

    Example scenarios: the port of its page is taken, its library is not installed.
    """


class ProcessError(TelepulseError, RuntimeError):
    """A process that was started fails, or does not end.

    Example scenarios: a node whose port is taken, a relay that was killed.
    """


class DiscoveryError(TelepulseError, OSError):
    """Nodes cannot be announced or found on the local network.

    Example scenarios: no network that carries multicast, several nodes where one is wanted, an
    address that cannot be announced.
    """


class BenchError(TelepulseError, RuntimeError):
    """A bench cannot be measured, or a calibration fitted.

    Example scenarios: the film does not move when the drive does, it reports more force than
    allowed, all reference loads are the same.
    """


class RealtimeError(TelepulseError, RuntimeError):
    """Real-time settings cannot be applied as requested.

    Example scenarios: an unknown setting, a priority above 98, a strict request by a user who may
    not use SCHED_FIFO.
    """


class ProcessLimitError(TelepulseError, OSError):
    """The system's limits for this process are below a node's needs.

    Example scenarios: `ulimit -n 14`, `ulimit -v 300000`.
    """


class OptionError(TelepulseError, ValueError):
    """An option of a command has no such value.

    Example scenarios: a level of the log that does not exist.
    """


class SweepError(TelepulseError, RuntimeError):
    """A study cannot be computed: a case fails, a worker dies, no Dask scheduler answers."""


# Cause → meaning, in one line.
CAUSE_MEANINGS = {
    # Messages between the nodes.
    "oversized": "messages above 64 KiB; no node of this project sends them",
    "truncated": "messages that end too early; the peer is no node, or bytes were lost",
    "not_msgpack": "bytes that are no message; the peer is no node, or bytes were altered",
    "version": "messages of another protocol version: run the same version on both nodes",
    "malformed": "messages with fields that do not fit; the peer is no node, or of another version",
    "not_finite": "samples that are NaN or infinite: check the sensor",
    "description": "an invalid stream description: check the sensing node's scene",
    "before_welcome": "frames that came before the stream's description; usual while joining",
    "session": "messages of an earlier session; usual after a restart of the sensing node",
    "before_clock": "frames that came before the clock offset was known; usual while joining",
    "mismatch": "frames that do not match the stream's description",
    "timestamp": "frames whose time is far from the present or does not fit their number:"
    " a clock was set, or the stream is forged",
    "duplicate": "samples that had arrived already",
    "overlap": "samples that had arrived already, in a frame cut differently",
    "too_old": "samples older than the buffer keeps",
    "overflow": "samples too far ahead of what is played",
    "implausible": "clock replies before their request,"
    " or an end after more samples than there was time for",
    "unasked": "clock replies to an unknown or already answered request",
    "unexpected": "messages that only the other kind of node sends: check the address",
    "flood": "messages dropped because a peer sent far more than it should:"
    " it is broken or hostile",
    "held_back": "times when a sensing node left messages unread for 5 ms:"
    " displays send far more than they should",
    "too_many_displays": "displays beyond the 1 000 that a sensing node serves: use a relay",
    "subscription": "subscriptions to topics that are not published here; the connection was cut",
    "too_many_connections": "connections beyond what this node has files for, which were cut:"
    " a peer connects repeatedly, or the limit is too low (ulimit -n)",
    # Connections, where keys are used.
    "no_key": "connections without a key to a node with one, or the reverse:"
    " give both --key and --peer",
    "unknown_key": "peers whose key is not on this node's allow-list: telepulse keys allow adds it",
    "revoked_key": "connections with a key that was allowed before and has been revoked",
    "list_unreadable": "connections refused while this node's changed allow-list cannot be read:"
    " its log names the reason",
    "revoked": "the other node allowed this node's key before and has revoked it;"
    " to undo that, there: telepulse keys allow",
    "not_authentic": "bytes not encrypted for this node: the peer has a wrong public key of it"
    " (--peer), or they were altered on the way",
    "replayed": "encrypted messages that came twice or out of order: they are repeated on the way",
    "handshake": "connections that ended before they were authenticated:"
    " no node, a wrong --peer, or a network that breaks off",
    "refused_key": "connections refused because the other node's allow-list lacks this node's key",
    # Live sensors.
    "partial": "the rest of a line or frame that began before this node listened",
    "framing": "bytes that are no frame: check baud rate and format",
    "crc": "frames with a wrong checksum: check the sensor's cable",
    "format": "frames of an unknown format: check the sensor's firmware",
    "not_a_number": "lines without a number in the scene's column",
    "device_time": "lines whose device time does not follow the last",
    "counter": "sample counters that jump: the sensor lost samples or restarted",
    "not_decoded": "CAN messages that the database does not describe",
    "bus_error": "errors on the CAN bus: check cable, termination and bit rate",
    "behind": "samples whose time had long passed",
    "backlog": "reads dropped because the node did not fetch them in time",
}


def explain_causes(rejected: Mapping[str, int]) -> list[str]:
    """Return a line for each cause: its count, its name and its meaning."""
    return [
        f"{count} {cause}" + (f": {CAUSE_MEANINGS[cause]}" if cause in CAUSE_MEANINGS else "")
        for cause, count in sorted(rejected.items())
    ]
