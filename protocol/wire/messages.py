"""Wire messages: encode, decode, validate.

Data goes from the sensing node to its displays as frames, one msgpack array each:

    [version, session, first_sample, t_first_ns, period_ns, channels, bytes_per_sample, payload]

`payload` contains consecutive samples as little-endian floats, sample by sample. `first_sample` is
a sequence number: the number of earlier samples of the session, so that a display counts missing
samples and not frames. Times are on the sensing node's clock.

Control messages go both ways as msgpack arrays [version, kind, ...]. For any bytes, decoding
returns a valid message or raises WireError with the cause under which it is counted. In every
version the first field is the version, and the first control message of a display is a hello.
"""

import math
import struct
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import msgpack
import numpy as np
from numpy.typing import NDArray

from protocol.config.quantities import MAX_NAME
from protocol.errors import VersionError, WireError
from protocol.wire.description import StreamDescription, description_from_wire

VERSION: Final = 2
# Greatest size of any message between the nodes.
MAX_FRAME_BYTES: Final = 65_536
# Greatest size of a frame besides its samples.
HEADER_BYTES: Final = 50
MAX_CHANNELS: Final = 64
MAX_PERIOD_NS: Final = 10_000_000_000
# Sample counts are exact in a float, and suffice for 285 years at 1 MHz. Times, up to 146 years
# from a clock's zero, can be added and extrapolated within 64 bits.
TIME_RANGE = range(-(1 << 62), 1 << 62)
COUNT_RANGE = range(1 << 53)
# A set-point is valid for up to 17 s.
VALIDITY_RANGE = range(1, 1 << 34)
_SESSION, _COUNT, _TIME = range(1 << 63), COUNT_RANGE, TIME_RANGE
# Bound of a sample, far above any pulse; figures computed from it stay finite.
LARGEST_N: Final = 1e6
_FORMATS: dict[int, np.dtype[Any]] = {4: np.dtype("<f4"), 8: np.dtype("<f8")}
_CODES = {4: "f", 8: "d"}

_pack: Callable[[object], bytes] = msgpack.Packer(use_bin_type=True).pack


class Frame(NamedTuple):
    """A batch of consecutive samples.

    Attributes
    ----------
    session : int
        Random number of the sensing node's run, 0 to 2^63 - 1.
    first_sample : int
        Sequence number of the first sample, 0 to 2^53 - 1.
    t_first_ns : int
        Time of that sample on the sensing node's clock, within ±2^62.
    period_ns : int
        Time between samples, 1 to 10^10.
    values : ndarray, shape (samples, channels)
        float32 or float64, in N.
    """

    session: int
    first_sample: int
    t_first_ns: int
    period_ns: int
    values: NDArray[Any]

    def samples_of(self, channel: int) -> "ChannelSamples":
        """Return the samples of a channel, counted from 0."""
        forces_n: list[float] = self.values[:, channel].tolist()
        return channel_samples(self.first_sample, self.t_first_ns, self.period_ns, forces_n)


# A frame without arrays: its fields after the version, with the times of all samples in place of
# the first one's; then the payload's forces in N, sample by sample.
FlatFrame = tuple[int, int, list[int], int, int, int, bytes, tuple[float, ...]]


class ChannelSamples(NamedTuple):
    """The samples of one channel of a frame: times on the sensing node's clock, forces in N."""

    first_sample: int
    period_ns: int
    times_ns: list[int]
    forces_n: list[float]


def channel_samples(
    first_sample: int, t_first_ns: int, period_ns: int, forces_n: list[float]
) -> ChannelSamples:
    """Return samples with their times; the first was taken at `t_first_ns`."""
    end_ns = t_first_ns + len(forces_n) * period_ns
    times_ns = list(range(t_first_ns, end_ns, period_ns))
    return ChannelSamples(first_sample, period_ns, times_ns, forces_n)


def encode_frame(frame: Frame) -> bytes:
    """Encode a frame; its values must be float32 or float64 of shape (samples, channels)."""
    session, first_sample, t_first_ns, period_ns, values = frame
    width = values.itemsize
    if values.dtype is not _FORMATS[width]:
        values = values.astype(_FORMATS[width])
    channels, payload = values.shape[1], values.tobytes()
    return _pack((VERSION, session, first_sample, t_first_ns, period_ns, channels, width, payload))


def decode_frame(data: bytes) -> Frame:
    """Decode a frame, its samples as an array. Raises WireError as `decode_flat_frame` does."""
    return with_array(decode_flat_frame(data))


def with_array(flat: FlatFrame) -> Frame:
    """Return a frame that was decoded flat with its samples as an array."""
    session, first_sample, times_ns, period_ns, channels, width, payload, _ = flat
    values = np.frombuffer(payload, _FORMATS[width]).reshape(-1, channels)
    return Frame(session, first_sample, times_ns[0], period_ns, values)


def decode_flat_frame(data: bytes) -> FlatFrame:
    """Decode a frame of at most `MAX_FRAME_BYTES`, its samples as one flat tuple.

    A display does so, because for a few samples an array takes longer. Raises WireError with the
    cause "oversized", "truncated", "not_msgpack", "version", "malformed" or "not_finite".
    """
    fields = _unpack(data)
    if len(fields) != 8:
        raise WireError("malformed", f"a frame has 8 fields, this one {len(fields)}")
    _, session, first_sample, t_first_ns, period_ns, channels, width, payload = fields
    if not (
        type(session) is type(first_sample) is type(t_first_ns) is type(period_ns) is int
        and type(channels) is type(width) is int
        and type(payload) is bytes
    ):
        raise WireError("malformed", "a frame's field has the wrong type")
    # Comparisons: a range would compute its steps as well.
    if not (
        0 <= session < _SESSION.stop
        and 0 <= first_sample < _COUNT.stop
        and _TIME.start <= t_first_ns < _TIME.stop
        and 0 < period_ns <= MAX_PERIOD_NS
        and 0 < channels <= MAX_CHANNELS
        and width in _FORMATS
    ):
        raise WireError("malformed", "a frame's field is out of range")
    if not payload or len(payload) % (channels * width):
        raise WireError("malformed", f"{len(payload)} bytes are not whole samples")
    numbers = struct.unpack(f"<{len(payload) // width}{_CODES[width]}", payload)
    # The norm is one call for all; it may be too large although no sample is.
    if not math.hypot(*numbers) <= LARGEST_N and not all(abs(x) <= LARGEST_N for x in numbers):
        raise WireError("not_finite", f"a sample is NaN, infinite or beyond {LARGEST_N:.0e} N")
    end_ns = t_first_ns + len(numbers) // channels * period_ns
    times_ns = list(range(t_first_ns, end_ns, period_ns))
    return session, first_sample, times_ns, period_ns, channels, width, payload, numbers


class Hello(NamedTuple):
    """Request of a display for the stream's description."""

    display: str


class Welcome(NamedTuple):
    """Answer of the sensing node: its session, the samples sent so far, the stream."""

    session: int
    samples_sent: int
    description: StreamDescription


class Bye(NamedTuple):
    """End of the session, after `samples_sent` samples."""

    session: int
    samples_sent: int


class ClockRequest(NamedTuple):
    """Request of a display for the sensing clock, sent at the display's time t1."""

    t1_ns: int


class ClockReply(NamedTuple):
    """Sensing clock when the request arrived (t2) and when this reply left (t3)."""

    session: int
    t1_ns: int
    t2_ns: int
    t3_ns: int


class DisplayReport(NamedTuple):
    """Report of a display on the received stream; unknown figures are NaN.

    The sensing node prints the account and the playout delay; it shows no other figure.
    """

    session: int
    display: str
    played: int
    predicted: int
    late: int
    lost: int
    one_way_delay_p50_ms: float
    one_way_delay_p99_ms: float
    playout_delay_ms: float
    force_rmse_n: float


class SetPoint(NamedTuple):
    """Hold-down force that a display's finger requests at the wrist.

    press: random number of the display's run, which holds the permission to press. number: count of
    its earlier set-points. t_ns: sensing clock at which the finger pressed so. valid_for_ns: age
    up to which the set-point may be applied. force_n: 0 or more.
    """

    session: int
    press: int
    number: int
    t_ns: int
    valid_for_ns: int
    force_n: float


class ProbeReport(NamedTuple):
    """Answer to a set-point: its display's account, and the probe's state.

    received: set-points up to the newest one that arrived, including lost ones. refused: of all
    displays. depth_m: position of the probe, 0 at first touch.
    """

    session: int
    press: int
    received: int
    applied: int
    superseded: int
    refused: int
    state: str
    hold_down_n: float
    depth_m: float


ControlMessage = (
    Hello | Welcome | Bye | ClockRequest | ClockReply | DisplayReport | SetPoint | ProbeReport
)

_HELLO: Final = "hello"
# Class and fields of each kind: types, or ranges of an int. The type float admits int and NaN.
_KINDS: dict[str, tuple[type[ControlMessage], tuple[type | range, ...]]] = {
    _HELLO: (Hello, (str,)),
    "welcome": (Welcome, (_SESSION, _COUNT, dict)),
    "bye": (Bye, (_SESSION, _COUNT)),
    "clock?": (ClockRequest, (_TIME,)),
    "clock": (ClockReply, (_SESSION, _TIME, _TIME, _TIME)),
    "report": (DisplayReport, (_SESSION, str, *[_COUNT] * 4, *[float] * 4)),
    "set_point": (SetPoint, (_SESSION, _SESSION, _COUNT, _TIME, VALIDITY_RANGE, float)),
    "probe": (ProbeReport, (_SESSION, _SESSION, *[_COUNT] * 4, str, float, float)),
}
_NAMES = {kind: name for name, (kind, _) in _KINDS.items()}


def encode_control(message: ControlMessage) -> bytes:
    """Encode a control message."""
    name = _NAMES[type(message)]
    if isinstance(message, Welcome):
        return _pack([VERSION, name, *message[:-1], message.description.to_wire()])
    return _pack([VERSION, name, *message])


def decode_control(data: bytes) -> ControlMessage:
    """Decode a control message. Raises WireError, also with the cause "description"."""
    fields = _unpack(data)
    name = fields[1] if len(fields) > 1 else None
    if not isinstance(name, str) or name not in _KINDS:
        raise WireError("malformed", f"unknown kind of control message {_shown(name)}")
    kind, types = _KINDS[name]
    values = fields[2:]
    if len(values) != len(types):
        raise WireError("malformed", f"{name} has {len(types)} fields, this one {len(values)}")
    for position, (value, expected) in enumerate(zip(values, types, strict=True)):
        if not _fits(value, expected):
            raise WireError("malformed", f"{name}: field {position} does not fit")
    if kind is Welcome:
        values[-1] = description_from_wire(values[-1])
    elif kind is SetPoint and not 0 <= values[-1] <= LARGEST_N:
        raise WireError("not_finite", f"a set-point is not within 0 and {LARGEST_N:.0e} N")
    elif kind is ProbeReport and not all(abs(value) <= LARGEST_N for value in values[-2:]):
        raise WireError("not_finite", f"{name}: a figure is NaN, infinite or beyond 1e+06")
    return kind(*values)


def _fits(value: object, expected: type | range) -> bool:
    if isinstance(expected, range):
        return type(value) is int and value in expected
    if expected is float:
        return type(value) in (float, int)
    if expected is str:
        # Names are printed on terminals, so control characters are refused.
        return isinstance(value, str) and len(value) <= MAX_NAME and value.isprintable()
    return type(value) is expected


def _unpack(data: bytes) -> list[Any]:
    """Decode an array whose first field is the protocol version. Raises WireError."""
    if len(data) > MAX_FRAME_BYTES:
        raise WireError("oversized", f"{len(data)} bytes, at most {MAX_FRAME_BYTES} are taken")
    try:
        # msgpack allocates a container before it reads its content. Without limits, nested empty
        # containers would take hundreds of megabytes.
        fields = msgpack.unpackb(
            data, raw=False, max_array_len=MAX_CHANNELS, max_map_len=MAX_CHANNELS
        )
    except (ValueError, msgpack.UnpackException) as error:
        cause = "truncated" if "incomplete" in str(error) else "not_msgpack"
        raise WireError(cause, f"not a msgpack message: {error!r:.80}") from None
    if type(fields) is not list or not fields:
        raise WireError("malformed", "a message is a msgpack array")
    if type(fields[0]) is not int or fields[0] != VERSION:
        is_hello = type(fields[0]) is int and fields[1:2] == [_HELLO]
        raise VersionError(_shown(fields[0]), VERSION, is_hello)
    return fields


def _shown(field: object) -> str:
    """Return a field for an error message; for a container, which may be too deep, its type."""
    return f"{field!r:.40}" if isinstance(field, int | str) else type(field).__name__
