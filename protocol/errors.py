"""The errors a user can meet; `TelepulseError` catches them all.

TelepulseError
 +-- SceneError      (ValueError)  a scene file or a quantity in it cannot be used
 +-- WireError       (ValueError)  bytes from a peer are not a valid message
 +-- AddressError    (OSError)     a socket cannot be bound or connected
 +-- SourceError     (OSError)     a sensor or recording cannot be read
 +-- OutputError     (OSError)     a result cannot be written
"""


class TelepulseError(Exception):
    """Root of all errors this project raises on purpose."""


class SceneError(TelepulseError, ValueError):
    """A scene cannot be used.

    Example scenarios: an unknown key, a length given in newtons, a value out of range,
    a missing file.
    """


class WireError(TelepulseError, ValueError):
    """Bytes from a peer are not a valid message; `cause` is the name it is counted under.

    Example scenarios: not msgpack, truncated, another protocol version, a NaN sample.
    """

    def __init__(self, cause: str, message: str) -> None:
        super().__init__(message)
        self.cause = cause


class AddressError(TelepulseError, OSError):
    """A ZeroMQ address cannot be used.

    Example scenarios: the port is taken, the address has no port, the host is unknown.
    """


class SourceError(TelepulseError, OSError):
    """A source of samples cannot be opened or read.

    Example scenarios: a missing recording, a column that is not there, a file with no numbers.
    """


class OutputError(TelepulseError, OSError):
    """A result cannot be written.

    Example scenarios: the folder does not exist, the disk is full.
    """
