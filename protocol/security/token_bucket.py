"""A bound on how often something may happen: a rate, and a burst above it. Pure: time comes in."""


class TokenBucket:
    """Tokens that are taken one at a time or several, and come back at a steady rate.

    Parameters
    ----------
    rate_per_s : float
        Tokens that come back in a second.
    burst : float
        The most that are there, as at the beginning.
    """

    def __init__(self, rate_per_s: float, burst: float) -> None:
        self._rate_per_ns = rate_per_s * 1e-9
        self._burst = self._tokens = burst
        self._now_ns: int | None = None

    def change_rate(self, rate_per_s: float) -> None:
        """Have tokens come back at another rate from now on; none is given for it."""
        self._rate_per_ns = rate_per_s * 1e-9

    def take(self, now_ns: int, count: float = 1) -> bool:
        """Take so many tokens at `now_ns`; return whether they were there, else none is taken."""
        if self._now_ns is not None and now_ns > self._now_ns:
            elapsed_ns = now_ns - self._now_ns
            self._tokens = min(self._burst, self._tokens + elapsed_ns * self._rate_per_ns)
        self._now_ns = now_ns
        if count > self._tokens:
            return False
        self._tokens -= count
        return True
