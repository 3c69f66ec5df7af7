"""Errors that a user can see.

`except TelepulseError` catches all of these.
"""

import difflib
from collections.abc import Iterable

from protocol.faults import FaultKind


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
    kind: that of the fault; its value, such as "refused", will do.
    """

    def __init__(self, kind: FaultKind | str, message: str) -> None:
        super().__init__(message)
        self.kind = FaultKind(kind)


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
