"""The stand-in: what is felt where no sample has arrived, and whether to rely on it."""

from display_node.compensation import PulseSize, Trust
from display_node.prediction import UNLEARNT, build_predictor
from display_node.scene import DisplayScene
from display_node.smoothing import Smoothing
from protocol.messages import Frame


class StandIn:
    """One session's predictor, with its jumps smoothed and its error judged. Pure.

    Forces are at the wrist, in N; times are the sensing clock's but for now_ns.
    """

    def __init__(self, scene: DisplayScene) -> None:
        self._channel = scene.channel
        self._tick_ns = scene.tick_ns
        self._predictor = build_predictor(scene.predictor, scene.tick_ns)
        self._smoothing = Smoothing(scene.tick_ns)
        self._size = PulseSize()
        may_trust = scene.compensation_ns is None and scene.predictor not in UNLEARNT
        self._trust = Trust() if may_trust else None

    @property
    def trusted(self) -> bool | None:
        """Whether it is trusted with all of the delay; None where the scene leaves it no say."""
        return None if self._trust is None else self._trust.trusted

    def observe(self, frame: Frame) -> None:
        """A frame has arrived, late or not."""
        first_ns, period_ns = frame.t_first_ns, frame.period_ns
        values = frame.values[:, self._channel].tolist()
        end_ns = first_ns + len(values) * period_ns
        self._predictor.observe(list(range(first_ns, end_ns, period_ns)), values)
        if self._trust is not None:
            self._size.observe(first_ns, values)

    def work(self) -> None:
        """Do a tick's share of the learning."""
        self._predictor.work()

    def judge(self, now_ns: int, horizon_ns: int) -> None:
        """How well it does now with all of the delay: predicting horizon_ns after the newest."""
        if self._trust is not None:
            self._trust.judge(now_ns, self.error_n(horizon_ns), self._size.size)

    def error_n(self, horizon_ns: int) -> float | None:
        """RMSE expected so far after the newest sample; None while nothing is known of it."""
        return self._predictor.error_n(horizon_ns)

    def complete(
        self, path_n: list[float], count: int, instant_ns: int, newest_ns: int
    ) -> list[float]:
        """The force at `count` instants a tick apart, the first instant_ns, without a jump.

        path_n: of the first of them, as received; newest_ns: the newest sample's time.
        """
        known = len(path_n)
        if known == count and not self._smoothing.busy:
            return path_n
        predict, tick_ns = self._predictor.predict, self._tick_ns
        path_n += [predict(instant_ns + step * tick_ns) for step in range(known, count)]
        return self._smoothing.join(path_n, instant_ns, newest_ns)
