"""The force leaves the finger when the link is lost, the loop stalls, or a fault is latched.

The gain of all force targets falls to 0, and returns by a ramp. After a fault it stays at 0, and
the drives then withdraw their tips (`pulse_drives/withdrawal.py`).
"""

from display_node.control.scene import SafetyScene
from protocol.faults import Fault


class Fade:
    """Gain of the forces of all contactors of a display, tick by tick.

    Attributes
    ----------
    gain
        Factor of the references, 0 to 1.
    held
        Whether every stream counts as stale, for a caller that presses only at times.
    alive
        Whether the stream was not stale in the last tick.
    faults
        Latched faults, the first one first. A drive latches its own as well (`Supervisor`), because
        it withdraws the tip even if the loop hangs.
    """

    def __init__(self, scene: SafetyScene, tick_ns: int) -> None:
        self._fade = tick_ns / scene.fade_ns
        self._ramp = tick_ns / scene.ramp_ns
        self._stale_ticks = scene.stale_after_ns // tick_ns
        self.gain = 0.0
        self.held = self.alive = False
        self.faults: list[Fault] = []

    def skip(self, elapsed_ticks: int) -> None:
        """Fade for missed ticks; call it before `advance` of the tick that ends a stall.

        During a stall the finger feels a constant force, as with a stream without samples. So the
        gain falls after the same time and at the same rate, and the pulse returns by a ramp.

        Parameters
        ----------
        elapsed_ticks
            Ticks from the last one that ran; 1 where none was missed.
        """
        self.gain = max(0.0, self.gain - self._fade * max(0, elapsed_ticks - self._stale_ticks))

    def advance(self, alive: bool) -> float:
        """Return the gain of the next tick.

        Parameters
        ----------
        alive
            False where the stream is stale; the gain then falls to 0, as after a fault.
        """
        self.alive = alive
        if not alive or self.held or self.faults:
            self.gain = max(0.0, self.gain - self._fade)
        elif self.gain < 1.0:
            self.gain = min(1.0, self.gain + self._ramp)
        return self.gain

    def fault(self, fault: Fault) -> None:
        """Latch a fault: the target falls to 0 N until a new start.

        One of the same kind, part and contactor as before, whose figures differ, is not repeated.
        """
        if all(known.identity != fault.identity for known in self.faults):
            self.faults.append(fault)
