"""Where a drive's commands lead: the sum of the speeds that it was told, each while it was told."""


class ToldWay:
    """Pure: times come in. One thread may tell while another asks."""

    def __init__(self) -> None:
        # When the last speed was told, the way until then, that speed, and the one before it.
        self._last = (0, 0.0, 0.0, 0.0)

    def tell(self, speed_m_per_s: float, now_ns: int) -> None:
        """The drive is told a speed, perhaps the same again."""
        _, _, before, _ = self._last
        if speed_m_per_s != before:
            self._last = (now_ns, self.way_m(now_ns), speed_m_per_s, before)

    def way_m(self, now_ns: int) -> float:
        """The way until a time that is not before the last change but one."""
        told_ns, way_m, speed, before = self._last
        passed_s = (now_ns - told_ns) * 1e-9
        return way_m + passed_s * (speed if passed_s >= 0 else before)
