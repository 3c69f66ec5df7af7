"""False but well-formed messages to a receiver: three bytes choose the kind and the error."""

import struct

from fuzz.stream_play import StreamPlay

_PIECE = struct.Struct("<Bh")
MOST_STEPS = 200
TIME, FRAME, REPLY, WELCOME, BYE, ANOTHER_TIME = range(6)


def seeds() -> list[bytes]:
    """Return a stream that is joined, played and ended; one with losses, reordering and steps."""
    joined = [(WELCOME, 1), *[(TIME, 20), (REPLY, 0)] * 6]
    played = [*joined, *[(FRAME, 0), (TIME, 8)] * 20, (BYE, 0), (TIME, 500)]
    hard = [*joined, (FRAME, 0), (FRAME, 8), (FRAME, -16), (TIME, 40), (ANOTHER_TIME, 5)]
    stepped = [*hard, *[(TIME, 50), (REPLY, 9000)] * 5, (FRAME, 0), (WELCOME, 3), (BYE, 7)]
    return [b"".join(_PIECE.pack(*piece) for piece in play) for play in (played, stepped)]


def try_one(data: bytes) -> None:
    """Send the messages; every sample stays accounted for."""
    play = StreamPlay()
    steps = (
        *(play.pass_time, play.frame, play.clock_reply, play.welcome, play.bye),
        play.frame_of_another_time,
    )
    count = min(len(data) // _PIECE.size, MOST_STEPS)
    for what, off in _PIECE.iter_unpack(data[: count * _PIECE.size]):
        steps[what % len(steps)](off)
