"""Errors that a user can see, and the causes by which refused messages and peers are counted.

`except TelepulseError` catches all of these.
"""

import difflib
from collections.abc import Iterable, Mapping


class TelepulseError(Exception):
    """Base of all errors that telepulse raises deliberately."""


class SceneError(TelepulseError, ValueError):
    """A scene cannot be used: an unknown key, a length in newtons, a value out of range."""


class WireError(TelepulseError, ValueError):
    """Bytes from a peer are not a valid message: truncated, another protocol version, a NaN sample.

    cause: the name under which the refusal is counted.
    """

    def __init__(self, cause: str, message: str) -> None:
        super().__init__(message)
        self.cause = cause


class VersionError(WireError):
    """A message is of another version of the protocol, so that its other fields may differ.

    is_hello: whether a display asks for the stream's description, as displays of every version do.
    """

    def __init__(self, version: str, own: int, is_hello: bool = False) -> None:
        super().__init__(
            "version",
            f"the peer has version {version} of the protocol, this node version {own}; install"
            " the same version of telepulse on both machines",
        )
        self.is_hello = is_hello


class AddressError(TelepulseError, OSError):
    """A ZeroMQ address cannot be used: its port is taken or missing, its host is unknown."""


class KeyFileError(TelepulseError, ValueError):
    """A key file or an allow-list cannot be used.

    Examples: others may read the secret key, the file has a public key in place of a secret one, a
    name is not on the list.
    """


class ProtectionError(TelepulseError, ValueError):
    """A link cannot be protected: an address beyond this machine without keys."""


class SourceError(TelepulseError, OSError):
    """A source of samples cannot be opened or read: no such file or column, no numbers."""


class DriveError(TelepulseError, OSError):
    """A drive cannot be reached, refuses, or has failed.

    Examples: no such port, no answer, a wrong checksum, over-temperature, no home switch found.
    kind: the fault's short name.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


class OutputError(TelepulseError, OSError):
    """A result cannot be written: its folder does not exist, the disk is full."""


class SidecarError(TelepulseError, OSError):
    """A process beside a node cannot start: its port is taken, its library is not installed."""


class ProcessError(TelepulseError, RuntimeError):
    """A process that was started fails or does not end, such as a node whose port is taken."""


class DiscoveryError(TelepulseError, OSError):
    """Nodes cannot be announced or found on the local network.

    Examples: no network carries multicast, several nodes match, an address cannot be announced.
    """


class BenchError(TelepulseError, RuntimeError):
    """A bench cannot be measured, or a calibration cannot be fitted.

    Examples: the film does not respond to the drive or reports more force than allowed, all
    reference loads are the same.
    """


class DepthError(TelepulseError, RuntimeError):
    """A sweep of the hold-down gives no curve: too few beats, a probe that does not press."""


class RealtimeError(TelepulseError, RuntimeError):
    """Real-time settings cannot be applied as requested.

    Examples: an unknown setting, a priority above 98, a strict request without the right to it.
    """


class ProcessLimitError(TelepulseError, OSError):
    """The system's limits for this process are below a node's needs, such as `ulimit -n 14`."""


class ArgumentError(TelepulseError, ValueError):
    """An argument of a function cannot be used: a text for a number, a rate out of range."""


class OptionError(TelepulseError, ValueError):
    """An option of a command has no such value, such as an unknown level of the log."""


class SweepError(TelepulseError, RuntimeError):
    """A study cannot be computed: a case fails, a worker dies, no Dask scheduler answers."""


def suggest(word: str, known: Iterable[str]) -> str:
    """Return the end of an error message: the known word closest to `word`, or all of them."""
    close = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean {close[0]}?" if close else f"; known: {', '.join(known)}"


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
    "channel": "streams without a channel that the scene plays: compare `channel` in its [display]"
    " with the sensing node's source",
    "before_welcome": "frames that came before the stream's description; usual while joining",
    "session": "messages of an earlier session; usual after a restart of the sensing node",
    "before_clock": "frames that came before the clock offset was known; usual while joining",
    "mismatch": "frames that do not match the stream's description",
    "timestamp": "frames whose time is far from the present or does not fit their number:"
    " a clock was set, or the stream is forged",
    "duplicate": "samples or set-points that had arrived already",
    "overlap": "samples that had arrived already, in a frame cut differently",
    "too_old": "samples older than the buffer keeps",
    "overflow": "samples too far ahead of what is played",
    "implausible": "clock replies that arrive before their request was sent,"
    " or an end with an impossible number of samples",
    "unasked": "clock replies to an unknown or already answered request",
    "unexpected": "messages that only the other kind of node sends: check the address",
    "false_report": "reports of the probe that cannot be true",
    "press_held": "set-points of a display while another one presses",
    "no_probe": "set-points to a sensing node without a probe: add [sensing.press]",
    "flood": "messages dropped because a peer sent far more than it should:"
    " it is broken or hostile",
    "held_back": "times when a sensing node left messages unread for 5 ms:"
    " displays send far more than they should",
    "too_many_displays": "displays beyond the 1 000 that a sensing node serves: use a relay",
    "subscription": "subscriptions to topics that are not published here, or far too many marks;"
    " the connection was cut",
    "mark": "requests of a telemetry reader for marks that are malformed or older than a minute",
    "too_many_connections": "connections beyond this node's file descriptors, which were cut:"
    " a peer connects repeatedly, or the limit is too low (ulimit -n)",
    # Connections, where keys are used.
    "no_key": "connections without a key to a node with one, or the reverse:"
    " give both --key and --peer",
    "unknown_key": "peers whose key is not on this node's allow-list: telepulse keys allow adds it",
    "revoked_key": "connections with a key that was allowed before and has been revoked",
    "list_unreadable": "connections refused while this node's changed allow-list cannot be read:"
    " its log names the reason",
    "revoked": "the other node allowed this node's key before and has revoked it;"
    " to undo that, run telepulse keys allow there",
    "not_authentic": "bytes not encrypted for this node: the peer has a wrong public key of it"
    " (--peer), or they were altered on the way",
    "replayed": "encrypted messages that came twice or out of order: something repeats them",
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
