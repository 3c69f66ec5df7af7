"""The played instant, which follows the perceived delay E without a jump. Pure."""

from typing import Final

# The playout is at most one part in 20, 5 %, faster or slower than real time. This changes the
# interval of a resting heart's beats by less than it changes by itself (standard deviation 50 of
# 926 ms: Nunan et al. 2010), and is a third of the least change of a vibrotactile interval of 1 s
# that people notice (160 ms: Jones et al. 2009).
WARP_PARTS: Final = 20
# The playout jumps over larger differences.
JUMP_NS: Final = 500_000_000


class PlayoutClock:
    """The played instant, which advances at most 5 % faster or slower than real time.

    Changes of E and corrections of the clock offset are slewed, so the finger feels no jump. It
    jumps over a difference above 0.5 s (after a clock step, in a new session).
    """

    def __init__(self) -> None:
        self._now_ns: int | None = None
        self._instant_ns = 0

    def instant(self, now_ns: int, wanted_ns: int) -> int:
        """Return the instant to play at `now_ns`; `wanted_ns` is the instant that E requires.

        The result goes back only in a jump.
        """
        if self._now_ns is None:
            self._now_ns, self._instant_ns = now_ns, wanted_ns
            return wanted_ns
        elapsed_ns = now_ns - self._now_ns
        error_ns = wanted_ns - self._instant_ns - elapsed_ns
        if error_ns and -JUMP_NS <= error_ns <= JUMP_NS:
            most_ns = elapsed_ns // WARP_PARTS
            error_ns = max(-most_ns, min(error_ns, most_ns))
        self._instant_ns += elapsed_ns + error_ns
        self._now_ns = now_ns
        return self._instant_ns
