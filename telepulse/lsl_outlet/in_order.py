"""Frames in the order of their samples. Pure."""

from collections.abc import Iterator

from protocol.messages import Frame

# Longer than a link that reorders keeps a frame; later ones are missing.
HOLD_NS = 500_000_000


class InOrder:
    """Holds a frame back while one before it is missing and may still come.

    lost: samples that did not come in time.
    """

    def __init__(self) -> None:
        self._held: dict[int, tuple[int, Frame]] = {}
        self._next_sample: int | None = None
        self.lost = 0

    def take(self, frame: Frame, now_ns: int) -> Iterator[Frame]:
        """A frame has come; the frames whose turn it is."""
        if self._next_sample is None:
            self._next_sample = frame.first_sample
        if frame.first_sample >= self._next_sample:
            self._held[frame.first_sample] = (now_ns, frame)
        while self._held:
            first = min(self._held)
            if first > self._next_sample and now_ns - self._held[first][0] < HOLD_NS:
                return
            yield self._release(first)

    def rest(self) -> Iterator[Frame]:
        """What is still held, when nothing more comes."""
        while self._held:
            yield self._release(min(self._held))

    def _release(self, first: int) -> Frame:
        _, frame = self._held.pop(first)
        self.lost += first - (self._next_sample or 0)
        self._next_sample = first + len(frame.values)
        return frame
