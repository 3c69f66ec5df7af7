"""A quantile of delays of which old ones count less and less. Pure."""

BIN_NS = 1_000_000
BINS = 11_000


class ForgettingQuantile:
    """The level above which a given share of what was counted lies.

    A histogram of 1 ms bins from 0 to 11 s. Counting costs a step or two, whatever is in it,
    since the quantile's bin is carried on.
    """

    def __init__(self, share_above: float) -> None:
        self._share_above = share_above
        self._weights = [0.0] * BINS
        self._weight = 1.0
        self._total = 0.0
        # The quantile's bin and the weight above it, both carried on from one to the next.
        self._position = 0
        self._above = 0.0

    def add(self, value_ns: int, kept: float) -> int:
        """Count a value of 0 or more; the upper edge in ns of the quantile's bin.

        kept: what is left of the weight of all before it, above 0 and at most 1.
        """
        self._forget(kept)
        weights, weight = self._weights, self._weight
        counted = min(value_ns // BIN_NS, BINS - 1)
        weights[counted] += weight
        self._total += weight
        allowed = self._share_above * self._total
        position, above = self._position, self._above
        if counted > position:
            above += weight
        while above > allowed:
            position += 1
            above -= weights[position]
        while position and above + weights[position] <= allowed:
            above += weights[position]
            position -= 1
        self._position, self._above = position, above
        return (position + 1) * BIN_NS

    def _forget(self, kept: float) -> None:
        """Grow the weight of what comes next, which forgets like shrinking all old ones."""
        self._weight /= kept
        if self._weight > 1e100:
            scale = 1 / self._weight
            self._weights = [weight * scale for weight in self._weights]
            self._total *= scale
            self._above *= scale
            self._weight = 1.0
