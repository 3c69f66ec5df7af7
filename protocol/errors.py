"""The errors a user can meet; `TelepulseError` catches them all.

TelepulseError
 +-- SceneError      (ValueError)  a scene file or a quantity in it cannot be used
 +-- WireError       (ValueError)  bytes from a peer are not a valid message
 +-- AddressError    (OSError)     a socket cannot be bound or connected
 +-- KeyFileError    (ValueError)  a key file or an allow-list cannot be used
 +-- ProtectionError (ValueError)  a link beyond this machine would be open, or its keys do not fit
 +-- SourceError     (OSError)     a sensor or recording cannot be read
 +-- DriveError      (OSError)     a drive cannot be reached, or does not do as it is told
 +-- OutputError     (OSError)     a result cannot be written
 +-- SidecarError    (OSError)     a process beside a node cannot begin
 +-- ProcessError    (RuntimeError) a process that was started fails, or does not end
 +-- DiscoveryError  (OSError)     the local network cannot be asked, or has no one answer
 +-- BenchError      (RuntimeError) a bench or a calibration cannot be measured
 +-- RealtimeError   (RuntimeError) a real-time measure is none, or is not granted
 +-- ProcessLimitError (OSError)  this process may have too few files or too little memory
 +-- SweepError      (RuntimeError) a case of a study fails, or no cluster computes it
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


class KeyFileError(TelepulseError, ValueError):
    """A key file or an allow-list cannot be read, used or written.

    Example scenarios: others may read the secret key, a public key where the secret one is meant,
    a name that is not on the list.
    """


class ProtectionError(TelepulseError, ValueError):
    """A link cannot be protected as it must be.

    Example scenarios: an address beyond this machine without keys, a key without a peer.
    """


class SourceError(TelepulseError, OSError):
    """A source of samples cannot be opened or read.

    Example scenarios: a missing recording, a column that is not there, a file with no numbers.
    """


class DriveError(TelepulseError, OSError):
    """A drive cannot be reached, refuses, or has failed; `kind` is the short name of what.

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
    """A process beside a node cannot begin.

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

    Example scenarios: the film does not move when the drive does, it says more force than
    allowed, all reference loads are the same.
    """


class RealtimeError(TelepulseError, RuntimeError):
    """Real-time measures cannot be had as they are asked for.

    Example scenarios: no measure has that name, a priority above 98, all of it was asked for
    strictly and this user may not have SCHED_FIFO.
    """


class ProcessLimitError(TelepulseError, OSError):
    """The system lets this process have less than a node needs.

    Example scenarios: `ulimit -n 14`, `ulimit -v 300000`.
    """


class SweepError(TelepulseError, RuntimeError):
    """A study cannot be computed.

    Example scenarios: a case raises, a worker dies, no Dask scheduler at the address.
    """
