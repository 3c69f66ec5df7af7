"""A sensing side that makes the bytes that a display receives, in virtual time."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from display_node.display import Display
from display_node.prediction import PredictorName
from display_node.prediction.scene import own_predictor
from display_node.reception.receiver import Receiver
from display_node.scene import DisplayScene
from protocol.config.scene import load_section
from protocol.wire.description import StreamDescription
from protocol.wire.messages import (
    ClockReply,
    ClockRequest,
    ControlMessage,
    Frame,
    Hello,
    Welcome,
    encode_control,
    encode_frame,
)
from tests.support.streams import description

MS = 1_000_000
AHEAD_NS = 5_000_000_000
SCENES = Path(__file__).parents[2] / "scenes"


def display_scene(
    name: str, predictor: PredictorName = "linear", **changes: object
) -> DisplayScene:
    """Return the display's section of a shipped scene, with changes.

    By default, the predictor is one that does not learn: its output is simple to foresee, and a
    tick costs a fraction.
    """
    scene = load_section(SCENES / f"{name}.toml", "display", DisplayScene)
    return scene.model_copy(update={"predictor": own_predictor(predictor), **changes})


def display(
    name: str = "radial", predictor: PredictorName = "linear", **changes: object
) -> Display:
    """Return a display that `run` ticks once a ms."""
    return Display(display_scene(name, predictor, **{"tick_ns": MS, **changes}), "test")


@dataclass
class Sender:
    """Sender of frames, which answers a display's requests at once; its clock is 5 s ahead."""

    session: int = 7
    stream: StreamDescription = field(default_factory=description)
    sent: int = 0

    def answer(self, request: ControlMessage, now_ns: int) -> bytes | None:
        match request:
            case Hello():
                return encode_control(Welcome(self.session, self.sent, self.stream))
            case ClockRequest(t1_ns=t1_ns):
                t_ns = now_ns + AHEAD_NS
                return encode_control(ClockReply(self.session, t1_ns, t_ns, t_ns))
            case _:
                return None

    def serve(
        self, node: Display | Receiver, now_ns: int, step_ns: int = 0, until_ms: int = 0
    ) -> None:
        """Answer a display's requests of now, or of every ms until `until_ms`.

        step_ns: by how much the sender's clock has stepped.
        """
        for at_ns in range(now_ns, max(until_ms * MS, now_ns + 1), MS):
            for request in node.requests(at_ns):
                answer = self.answer(request, at_ns + step_ns)
                if answer is not None:
                    node.on_control(answer, at_ns)

    def frame(self, now_ns: int, force_n: float, count: int = 5) -> bytes:
        """Return a frame of which the last sample is taken at `now_ns` on the display's clock."""
        return self.frame_of(now_ns, [force_n] * count)

    def frame_of(self, now_ns: int, forces_n: list[float]) -> bytes:
        """Return a frame of these samples on every channel, the last one taken at `now_ns`."""
        stream, count = self.stream, len(forces_n)
        t_first_ns = now_ns + AHEAD_NS - (count - 1) * stream.period_ns
        column = np.array(forces_n, f"<f{stream.bytes_per_sample}")[:, np.newaxis]
        values = np.repeat(column, len(stream.channels), axis=1)
        frame = Frame(self.session, self.sent, t_first_ns, stream.period_ns, values)
        self.sent += count
        return encode_frame(frame)


def run(
    under_test: Display, sender: Sender | None, from_ms: int, to_ms: int, force_n: float = 0.3
) -> list[float]:
    """Return the felt force of each tick between two times, while 5 samples arrive every 5 ms.

    Without a sender the link is cut.
    """
    felt = []
    for ms in range(from_ms, to_ms):
        now_ns = ms * MS
        while under_test.work():
            pass
        felt.append(under_test.tick(now_ns).felt_n)
        if sender is None:
            under_test.requests(now_ns)
            continue
        sender.serve(under_test, now_ns)
        if ms % 5 == 0:
            under_test.on_frame(sender.frame(now_ns, force_n), now_ns)
    return felt
