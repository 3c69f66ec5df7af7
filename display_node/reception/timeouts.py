"""Times without a message after which a connection is treated as silent, stalled or cut. Pure."""

MS = 1_000_000
# TCP repeats lost data after 0.2 s and a round trip; the wait doubles each time the repetition is
# lost. A longer silence than the first wait is treated as a cut: a new connection is faster.
REPEATED_NS = 200 * MS
# After a stall of this process, queued messages arrive at once. The connection is dead if nothing
# follows them within this time.
FOLLOWS_WITHIN_NS = 150 * MS
# After a host's answer, data follows within some six round trips, unless a packet is lost.
STALLED_NS, STALLED_ANSWERS = 250 * MS, 2
CUT_NS = 500 * MS
# ZeroMQ would repeat a request to connect sooner, but always to the same address.
UNANSWERED_NS = 2_000 * MS
# Frames that a stream may omit.
PATIENCE_FRAMES = 3
# An unanswered request to connect is repeated after this many round trips, but not before
# `ANSWER_NS`. The kernel alone would repeat it after 1 s.
ANSWER_NS, ANSWER_ROUND_TRIPS = 100 * MS, 3
# Silence of a socket after which it is connected anew, with nothing beside it: this time, or so
# many times that for an answer. Over a long round trip, the handshakes take some six round trips,
# and so does TCP where a repetition is lost.
PATIENCE_NS, PATIENCE_ANSWERS = 2_000 * MS, 4


class Timeouts:
    """Times of silence, by the time that a frame covers and that in which an answer comes.

    `follows_ns`, `silence_ns` and `cut_ns` never fall in this order: the second connection is
    opened before everything is made anew.

    Parameters
    ----------
    frame_ns
        Time that a frame covers; 0 while no stream is known.
    answer_ns
        Time in which a reply to a request has come.

    Attributes
    ----------
    follows_ns
        After a stall of this process: until frames must follow those that had queued.
    silence_ns
        Until a second connection is opened beside the silent one.
    cut_ns
        Until all connections of a stream, silent together, are made anew.
    stalled_ns
        Of a second connection, from the host's answer to its first frame until it is opened again;
        twice as long with each attempt, up to `unanswered_ns`.
    unanswered_ns
        Of a second connection without an answer, until it is opened again at the newest address.
    """

    def __init__(self, frame_ns: int = 50 * MS, answer_ns: int = ANSWER_NS) -> None:
        self.frame_ns, self.answer_ns = frame_ns, answer_ns
        frames_ns = PATIENCE_FRAMES * frame_ns
        self.follows_ns = max(FOLLOWS_WITHIN_NS, answer_ns, frames_ns)
        self.silence_ns = max(REPEATED_NS + answer_ns, frames_ns)
        self.cut_ns = max(CUT_NS, self.silence_ns)
        self.stalled_ns = max(STALLED_NS, STALLED_ANSWERS * answer_ns) + frame_ns
        self.unanswered_ns = max(UNANSWERED_NS, answer_ns)


def answer_timeout_ns(round_trip_ns: int) -> int:
    """Return the time in which a reply to a request comes, for a measured round trip."""
    return max(ANSWER_NS, ANSWER_ROUND_TRIPS * round_trip_ns)


def patience_ns(answer_ns: int) -> int:
    """Return the silence after which one socket is connected anew."""
    return max(PATIENCE_NS, PATIENCE_ANSWERS * answer_ns)
