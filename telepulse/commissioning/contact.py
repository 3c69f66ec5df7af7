"""Contact under the actuator, from a slow ramp up and down: stiffness, touch and play."""

from dataclasses import dataclass

import numpy as np

from display_node.plant.contact import ContactLaw
from display_node.plant.film import FilmTable
from protocol.errors import BenchError
from telepulse.commissioning.press import Phase, Pressed
from telepulse.commissioning.response import Array, Input

# 95 % of a normal distribution lie within so many standard deviations.
WITHIN = 1.96
# Readings of so much time are taken together: a film's noise is not a place.
TOGETHER_S = 0.01
LEAST_PLACES = 8
# Of the largest force: below, the film does not tell where the tip is.
LOWEST_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Contact:
    """The finger's stiffness in N/m, the place of first touch in m from where the press began,
    and the play in m; each with its 95 % interval to either side.

    play_m below 0: the way back presses more than the way in. unexplained: RMS of the places that
    the fit leaves over, as a share of that of all places.
    """

    finger_n_per_m: float
    finger_within: float
    touch_m: float
    touch_within: float
    play_m: float
    play_within: float
    unexplained: float

    def pressed_n(self, law: ContactLaw, way: Input) -> Input:
        """The force that each place of the screw presses with, at rest, on its way in."""
        tip_m = way.values - self.touch_m
        force_n = np.array([law.force(x) for x in tip_m.tolist()])
        return Input(force_n, way.tick_s, held=False)


def fit_contact(pressed: Pressed, law: ContactLaw, film: FilmTable, lag_s: float) -> Contact:
    """Fit x = touch − play · [going back] + rubber F^(2/3) + F / finger by linear least squares.

    The rubber's part is the law's own. lag_s: from a command to the film's reading, without the
    film's filter, which is made good here. Raises BenchError for a record that does not tell.
    """
    assert pressed.up is not None
    assert pressed.down is not None
    both = Phase(pressed.up.begin_s, pressed.down.end_s)
    place_m, force_n, back = [], [], []
    for phase in (pressed.up, pressed.down):
        at_s, read_n = pressed.film(phase)
        seen_m = through_film(pressed.told(both, held=False), film)
        late_s = at_s + phase.begin_s - both.begin_s - lag_s
        x_m = np.interp(late_s, seen_m.tick_s * np.arange(len(seen_m.values)), seen_m.values)
        x_m, read_n = _together(at_s, x_m), _together(at_s, read_n) - pressed.recorder.zero_n
        place_m.append(x_m)
        force_n.append(read_n)
        back.append(np.full(len(x_m), float(phase is pressed.down)))
    x_m, f_n, down = (np.concatenate(parts) for parts in (place_m, force_n, back))
    keep = f_n > LOWEST_SHARE * f_n.max()
    if keep.sum() < LEAST_PLACES:
        raise BenchError(f"only {keep.sum()} places of the ramp press; at least {LEAST_PLACES}")
    x_m, f_n, down = x_m[keep], f_n[keep], down[keep]
    rubber_m = np.array([law.position(f) - f * law.finger_m_per_n for f in f_n.tolist()])
    columns = np.stack([np.ones_like(x_m), -down, f_n], axis=1)
    found, *_ = np.linalg.lstsq(columns, x_m - rubber_m)
    off_m = x_m - rubber_m - columns @ found
    covariance = np.linalg.inv(columns.T @ columns) * (off_m @ off_m) / (len(x_m) - 3)
    touch_m, play_m, softness = found.tolist()
    within = WITHIN * np.sqrt(np.diag(covariance))
    if softness <= 0:
        raise BenchError("the tip presses harder than the scene's rubber alone can; look at layer")
    return Contact(
        finger_n_per_m=1 / softness,
        finger_within=float(within[2] / softness**2),
        touch_m=touch_m,
        touch_within=float(within[0]),
        play_m=play_m,
        play_within=float(within[1]),
        unexplained=float(np.std(off_m) / np.std(x_m)),
    )


def through_film(told: Input, film: FilmTable) -> Input:
    """Return an input behind the film's filter; as it is where there is none."""
    from scipy.signal import lfilter, lfilter_zi, ss2tf

    low_pass = film.low_pass(told.tick_s)
    if low_pass is None:
        return told
    (over,), under = ss2tf(low_pass.a, low_pass.b, low_pass.c, low_pass.d)
    settled = lfilter_zi(over, under) * told.values[0]
    return Input(lfilter(over, under, told.values, zi=settled)[0], told.tick_s, told.held)


def _together(at_s: Array, values: Array) -> Array:
    """Means over stretches of TOGETHER_S."""
    _, where = np.unique(np.floor(at_s / TOGETHER_S), return_inverse=True)
    return np.asarray(np.bincount(where, values) / np.bincount(where))
