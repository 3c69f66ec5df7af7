"""Between the commanded microstep and the tip: the rotor's own resonance, and play."""

import math


class Rotor:
    """A stepper's rotor, held to the commanded position by a springy magnetic field.

    Second order: resonance in Hz, damping ratio ζ. Exact for a position commanded straight
    from tick to tick. Not modelled: the spring's softening near a lost step.

    matrix, shape (2, 4): position and speed after a tick, from those before it, the command's
    beginning and its travel.
    """

    def __init__(self, resonance_hz: float, damping: float, tick_s: float) -> None:
        import numpy as np
        from scipy.linalg import expm

        w = 2 * math.pi * resonance_hz
        system = np.zeros((4, 4))
        system[0, 1] = system[2, 3] = 1.0
        system[1, :3] = -w * w, -2 * damping * w, w * w
        moved = expm(system * tick_s)
        # The command's slope is its travel over the tick.
        moved[:, 3] /= tick_s
        self._position, self._speed = moved[0].tolist(), moved[1].tolist()
        self.matrix = moved[:2]
        self.position_m = 0.0
        self._speed_m_per_s = 0.0

    def step(self, from_m: float, to_m: float) -> float:
        """The rotor's position in screw travel after a tick that commands from_m to to_m."""
        x, v, travel = self.position_m, self._speed_m_per_s, to_m - from_m
        a, b, c, d = self._position
        self.position_m = a * x + b * v + c * from_m + d * travel
        a, b, c, d = self._speed
        self._speed_m_per_s = a * x + b * v + c * from_m + d * travel
        return self.position_m


class Backlash:
    """Backlash: what it drives stays where it is until one flank of the gap meets it.

    The worst case, in which nothing presses the nut to one flank of the thread.
    """

    def __init__(self, width_m: float) -> None:
        self._half_m = width_m / 2
        self._driven_m = 0.0

    def step(self, driving_m: float) -> float:
        """Where the driven side is when the driving side has come to driving_m."""
        half_m = self._half_m
        if driving_m > self._driven_m + half_m:
            self._driven_m = driving_m - half_m
        elif driving_m < self._driven_m - half_m:
            self._driven_m = driving_m + half_m
        return self._driven_m
