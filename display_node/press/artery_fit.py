"""Fit of the artery's law to beats: regularised least squares with the respiration of each. Pure.

A beat at one hold-down force shows where its levels lie between foot and peak. The pressures of
these levels are nearly the same in all beats, so how the levels move against each other over the
force shows the tube's law. Heights alone do not: near the closed artery, respiration changes them
by 40 %. So each beat's respiratory pressure is fitted with the law, near a common wave.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.press.artery_law import (
    MEAN_SHARE,
    PA_PER_N,
    TYPICAL_MEAN_N,
    TYPICAL_PULSE_N,
    ArteryLaw,
)
from display_node.press.learnt_beats import BeatLevels, BeatMemory
from display_node.press.respiration import WAVE, FittedWave, fit_wave
from protocol.tissue import COLLAPSE_PER_PA, TubeLaw

Floats = NDArray[np.float64]
# The probe's area changes forces by its factor, and the tube's constants by its reciprocal.
AREA_DEVIATION: Final = 0.3


class LawParameter(NamedTuple):
    """A parameter of the fit: its typical value, and by how much persons deviate from it.

    by_area: change of a logarithm with that of the probe's area.
    """

    name: str
    typical: float
    deviation: float
    by_area: float = 0.0


_TUBE: Final = TubeLaw.highest_at_mean(MEAN_SHARE)
_MEAN, _PULSE, _COLLAPSE, _DISTENSION = np.log(
    [
        TYPICAL_MEAN_N,
        TYPICAL_PULSE_N,
        PA_PER_N * COLLAPSE_PER_PA,
        PA_PER_N * _TUBE.distension_per_pa,
    ]
).tolist()
PARAMETERS: Final = (
    # Logarithms of the law's; a stiff artery's constants are 0.7 of a normal one's.
    LawParameter("gain", 0.0, 2.0),
    LawParameter("mean pressure", _MEAN, 0.3, 1.0),
    LawParameter("pulse pressure", _PULSE, 0.35, 1.0),
    LawParameter("collapse", _COLLAPSE, 0.2, -1.0),
    LawParameter("distension", _DISTENSION, 0.3, -1.0),
    # Pressures of the three levels between foot and peak.
    LawParameter("first quartile", 0.1, 0.25),
    LawParameter("second quartile", 0.46, 0.25),
    LawParameter("third quartile", 0.6, 0.25),
    # The film's level over the height at 1 N, and its change with the force.
    LawParameter("film", 0.0, 0.3),
    LawParameter("tilt", 0.0, 0.2),
)
GAIN, MEAN, PULSE, COLLAPSE, DISTENSION, FIRST, SECOND, THIRD, FILM, TILT = range(len(PARAMETERS))
LAW, LEVELS = slice(GAIN, FIRST), slice(FIRST, FILM)
MOST_DEVIATIONS: Final = 4.0
# Errors of a beat's levels: of its pressures, of its height, and the film's over the best height.
PRESSURE_ERROR, HEIGHT_ERROR, FILM_ERROR = 0.015, 0.01, 0.002
# Bound of what respiration adds to a beat's pressure.
MOST_RESPIRATION: Final = 0.25
# A beat counts less from this multiple of its expected error on.
OUTLIER: Final = 2.0
# Steps of a fit and their first damping.
STEPS, DAMPING = 2, 1e-3
# Starts of the rival: ln(mean pressure) from the typical one. Each is followed for so many beats.
STARTS: Final = (-0.4, 0.0, 0.3)
RIVAL_BEATS: Final = 3
# After so many beats, a rival is followed for three of this number, a multiple of three.
MANY_FITS, SELDOM = 40, 15
# The rival replaces the law if its cost is lower by this.
MARGIN: Final = 10.0
# Share of a beat's weight that each later beat takes.
FORGET: Final = 0.0003


class _Model(NamedTuple):
    """Levels of beats by the law, and their derivatives.

    levels_n: one row a beat. heights_n: of each beat's hold-down, without respiration. by_law:
    derivatives by the parameters, last axis. by_respiration, by_force: by the respiratory pressure
    and by the hold-down.
    """

    levels_n: Floats
    heights_n: Floats
    by_law: Floats
    by_respiration: Floats
    by_force: Floats


class ExpectedWave(NamedTuple):
    """Respiratory pressure that is expected of each beat.

    expected: at its peak. drift: from the peak to the foot. deviation: of what is expected.
    """

    expected: Floats
    drift: Floats
    deviation: Floats

    @property
    def certain(self) -> Floats:
        """Weight of what is expected."""
        weights: Floats = 1 / self.deviation**2
        return weights


class _Descent(NamedTuple):
    """A law after some steps: its cost, parameters, respiration and levels of the beats."""

    cost: float
    values: Floats
    respiration: Floats
    model: _Model


class ArteryFit:
    """The law that explains the levels of beats best, among those near a typical artery.

    law: the fitted law. beats: those that it is fitted to. respiration: wave of the newest beats.
    residues: what each beat deviates from the law: ln(height), and the film's level.
    """

    def __init__(self) -> None:
        self._typical: Floats = np.array([each.typical for each in PARAMETERS])
        area = AREA_DEVIATION * np.array([each.by_area for each in PARAMETERS])
        deviations = np.array([each.deviation for each in PARAMETERS])
        prior = np.diag(np.square(deviations)) + np.outer(area, area)
        self._certain: Floats = np.linalg.inv(prior).astype(np.float64)
        self._bounds: Floats = MOST_DEVIATIONS * np.sqrt(np.diag(prior)).astype(np.float64)
        self._values: Floats = self._typical.copy()
        self._rival: Floats = self._typical.copy()
        self._fits = 0
        self.beats = BeatMemory()
        self.respiration: FittedWave | None = None
        self.residues: Floats = np.zeros((2, 0))
        self.law = _law(self._values)

    def scale(self, log_gain: float) -> None:
        """Change the unit of the heights, before anything is fitted."""
        self._typical[GAIN] += log_gain
        self._values[GAIN] += log_gain
        self.law = _law(self._values)

    def film(self, forces_n: Floats) -> Floats:
        """Return the level of the foot over the height at hold-down forces."""
        level: Floats = self._values[FILM] + self._values[TILT] * (forces_n - 1.0)
        return level

    def observe(self, beat: BeatLevels) -> None:
        """Take a beat, and fit the law to all that are kept.

        A rival from an artery of another mean pressure takes its place once it explains the beats
        better. It keeps the law out of a minimum that only its vicinity has.
        """
        beats = self.beats
        beats.add(beat)
        if self.respiration is not None:
            beats.expect(self.respiration)
        if self._fits % RIVAL_BEATS == 0:
            self._rival = self._typical.copy()
            self._rival[MEAN] += STARTS[self._fits // RIVAL_BEATS % len(STARTS)]
        expected = ExpectedWave(beats["expected"], beats["drift"], beats["deviation"])
        found = self._descend(self._values, beats["respiration"], expected)
        if self._fits < MANY_FITS or self._fits % SELDOM < RIVAL_BEATS:
            none = np.zeros(len(beats.rows))
            rival = self._descend(self._rival, none, ExpectedWave(none, none, none + WAVE))
            self._rival = rival.values
            if rival.cost < found.cost - MARGIN:
                found = rival
                beats.expect_none()
        self._fits += 1
        self._values, beats["respiration"][:] = found.values, found.respiration
        self.residues = self._residues(found.model)
        self.law = _law(self._values)
        self.respiration = fit_wave(beats["at_s"], beats["respiration"], beat.at_s)

    def restart(self) -> None:
        """Begin with times that are unrelated to those before; what was learnt is kept."""
        self.beats.restart()
        self.respiration = None

    def _residues(self, model: _Model) -> Floats:
        """Return what each beat deviates from the law: ln(height), and the film's level."""
        levels_n = self.beats["levels_n"]
        seen, expected = (each[:, -1] - each[:, 0] for each in (levels_n, model.levels_n))
        logs = np.log(np.maximum(seen, 1e-12) / np.maximum(expected, 1e-12))
        feet = (levels_n - model.levels_n)[:, :2].mean(axis=1) / model.heights_n
        residues: Floats = np.clip(np.stack([logs, feet]), -1.0, 1.0)
        return residues

    def _descend(self, values: Floats, respiration: Floats, wave: ExpectedWave) -> _Descent:
        """Return the law after steps of Levenberg and Marquardt from `values`."""
        model, damping = self._model(values, respiration, wave.drift), DAMPING
        for _ in range(STEPS):
            errors = self.beats["levels_n"] - model.levels_n
            weights = self._weigh(errors, self._variances(model))
            trial = self._step(values, respiration, wave, model, errors, weights, damping)
            found = self._model(*trial, wave.drift)
            trial_errors = self.beats["levels_n"] - found.levels_n
            before = self._cost(errors, weights, values, respiration, wave)
            if self._cost(trial_errors, weights, *trial, wave) < before:
                (values, respiration), model, damping = trial, found, damping / 10
            else:
                damping *= 10
        # The likelihood compares laws with other variances; for it, no wave is assumed.
        errors, variances = self.beats["levels_n"] - model.levels_n, self._variances(model)
        weights, away = self._weigh(errors, variances), values - self._typical
        cost = (errors**2 * weights).sum() + np.log(variances).sum() + away @ self._certain @ away
        cost += respiration @ respiration / WAVE**2
        return _Descent(float(cost), values, respiration, model)

    def _step(
        self,
        values: Floats,
        respiration: Floats,
        wave: ExpectedWave,
        model: _Model,
        errors: Floats,
        weights: Floats,
        damping: float,
    ) -> tuple[Floats, Floats]:
        """Return the parameters and each beat's respiratory pressure after a damped step.

        The respiratory pressures are eliminated from the normal equations (Schur complement).
        """
        certain = wave.certain
        toward = weights * model.by_respiration
        own = (toward * model.by_respiration).sum(axis=1) + certain
        shared = np.matmul(toward[:, None, :], model.by_law)[:, 0]
        flat = model.by_law.reshape(-1, len(values))
        scaled = flat * weights.reshape(-1, 1)
        normal = scaled.T @ flat + self._certain - (shared / own[:, None]).T @ shared
        pull_own = (toward * errors).sum(axis=1) + certain * (wave.expected - respiration)
        pull = errors.ravel() @ scaled + self._certain @ (self._typical - values)
        pull -= shared.T @ (pull_own / own)
        change = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), pull)
        bounds = self._typical - self._bounds, self._typical + self._bounds
        trial: Floats = np.clip(values + change, *bounds)
        own_change = (pull_own - shared @ (trial - values)) / own
        return trial, np.clip(respiration + own_change, -MOST_RESPIRATION, MOST_RESPIRATION)

    def _cost(
        self,
        errors: Floats,
        weights: Floats,
        values: Floats,
        respiration: Floats,
        wave: ExpectedWave,
    ) -> float:
        """Return the weighted squares of errors, and of deviations from what is expected."""
        cost = (errors**2 * weights).sum()
        cost += wave.certain @ (respiration - wave.expected) ** 2
        away = values - self._typical
        return float(cost + away @ self._certain @ away)

    def _weigh(self, errors: Floats, variances: Floats) -> Floats:
        """Return the weights of the levels: older beats and outliers count less."""
        rms = np.sqrt((errors**2 / variances).mean(axis=1))
        kept = np.exp(-FORGET * self.beats["age_beats"])
        kept *= np.minimum(1.0, OUTLIER / np.maximum(rms, 1e-9))
        weights: Floats = kept[:, None] / variances
        return weights

    def _model(self, values: Floats, respiration: Floats, drift: Floats) -> _Model:
        """Return the beats' levels as the film shows them."""
        forces_n = self.beats["hold_down_n"]
        pressures = np.empty((len(respiration), 5))
        pressures[:, 0] = respiration + drift
        pressures[:, 1:4] = respiration[:, None] + values[LEVELS]
        pressures[:, 4] = respiration + 1.0
        model = _levels(values, pressures, forces_n)
        heights_n, tilt = model.heights_n[:, None], forces_n[:, None] - 1.0
        model.levels_n[:] += (values[FILM] + values[TILT] * tilt) * heights_n
        model.by_law[..., FILM] = heights_n
        model.by_law[..., TILT] = heights_n * tilt
        return model

    def _variances(self, model: _Model) -> Floats:
        """Return the variance of each level."""
        levels_n, moved_n = self.beats["levels_n"], self.beats["moved_n"]
        film_n = FILM_ERROR * float(model.heights_n.max())
        height_n = HEIGHT_ERROR * np.maximum(levels_n[:, -1] - levels_n[:, 0], 0.0)
        variances: Floats = (
            film_n**2
            + height_n[:, None] ** 2
            + (PRESSURE_ERROR * model.by_respiration) ** 2
            + (moved_n[:, None] * model.by_force) ** 2
        )
        return variances


def _levels(values: Floats, pressures: Floats, forces_n: Floats) -> _Model:
    """Return levels above the diastolic one, one row for each force, and their derivatives."""
    gain, mean_n, pulse_n, a, b = np.exp(values[LAW]).tolist()
    low_n = (mean_n - MEAN_SHARE * pulse_n - forces_n)[:, None]
    ends_n = np.concatenate([low_n + pulse_n * pressures, low_n + pulse_n, low_n], axis=1)
    below_n, above_n = np.minimum(ends_n, 0.0), np.maximum(ends_n, 0.0)
    closing, opening = np.exp(a * below_n), np.exp(-b * above_n)
    compliance = gain * closing * opening
    volume = gain * (closing / a + (1.0 - opening) / b)
    by_collapse = gain * (closing * (below_n - 1.0 / a))
    by_distension = gain * (above_n * opening - (1.0 - opening) / b)
    levels_n, heights_n = volume[:, :-2] - volume[:, -1:], volume[:, -2] - volume[:, -1]
    softer, by_respiration = compliance[:, :-2] - compliance[:, -1:], pulse_n * compliance[:, :-2]
    by_law = np.zeros((*levels_n.shape, len(values)))
    by_law[..., GAIN] = levels_n
    by_law[..., MEAN] = mean_n * softer
    by_law[..., PULSE] = pressures * by_respiration - MEAN_SHARE * pulse_n * softer
    by_law[..., COLLAPSE] = by_collapse[:, :-2] - by_collapse[:, -1:]
    by_law[..., DISTENSION] = by_distension[:, :-2] - by_distension[:, -1:]
    for number, level in enumerate((FIRST, SECOND, THIRD), 1):
        by_law[:, number, level] = by_respiration[:, number]
    return _Model(levels_n, np.maximum(heights_n, 1e-12), by_law, by_respiration, -softer)


def _law(values: Floats) -> ArteryLaw:
    gain, mean_n, pulse_n, collapse, distension = np.exp(values[LAW]).tolist()
    return ArteryLaw(gain, mean_n - MEAN_SHARE * pulse_n, pulse_n, collapse, distension)
