"""The fourth chapter: the pulse, its spectrum, and how both presets differ."""

from collections.abc import Callable

from sensing_node.sources.synthetic import PRESETS
from telepulse.reports.document import Chapter, Table
from telepulse.reports.paper import figures, numbers, spectrum
from telepulse.reports.paper.pulse import (
    SLOW_DC,
    SLOW_RESPIRATION,
    SLOW_RESPIRATION_HZ,
    deviation_n,
)
from telepulse.reports.paper.results import PaperResults


def chapter(results: PaperResults) -> Chapter:
    """The pulse that has the paper's spectrum, and the wide one."""
    spectra = results.spectra
    return Chapter(
        "The pulse and its spectrum",
        (*_method(results), *_presets(results)),
        (_waves(), _shares(results)),
        (
            figures.pulse(),
            figures.spectrum(spectra.paper),
            figures.presets(spectra.paper, spectra.wide),
        ),
    )


def _method(results: PaperResults) -> tuple[str, ...]:
    paper, limits_hz = results.spectra.paper, numbers.ENERGY_BELOW_HZ
    moved = max(abs(paper.below(hz) - paper.below_by_trapezoids(hz)) for hz in limits_hz)
    return (
        "The paper prints five shares of energy and names Welch's method; its settings here"
        f" are ours: {spectrum.SECONDS:g} s at {spectrum.RATE_HZ / 1000:g} kHz, Hamming windows of"
        f" {spectrum.SEGMENT} samples with half overlap, a transform of {spectrum.TRANSFORM},"
        " nothing detrended, a share as the sum of the bins below its frequency over the sum of"
        " all.",
        f"The pulse is three Gaussians a beat at {numbers.PULSE_PER_MIN} beats/min without their"
        f" mean, then, in units of their standard deviation, a constant of {SLOW_DC} and"
        f" respiration of {SLOW_RESPIRATION} RMS at {SLOW_RESPIRATION_HZ} Hz. All of these were"
        " fitted to the five shares: that they agree shows that such a pulse exists, not that"
        " it was the paper's.",
        "The lower shares rest on choices that the paper does not state. Drawing the density"
        " straight between bins moves one of them by"
        f" {100 * moved:.1f} points, and the mean decides the lowest"
        " alone.",
    )


def _presets(results: PaperResults) -> tuple[str, ...]:
    paper, wide = results.spectra.paper, results.spectra.wide
    narrow_ms, broad_ms = (
        [1e3 * wave.width_s for wave in PRESETS[name]] for name in ("paper", "wide")
    )
    return (
        "The preset “wide” is a typical radial pulse, with waves of"
        f" {min(broad_ms):.0f} to {max(broad_ms):.0f} ms instead of {min(narrow_ms):.0f} to"
        f" {max(narrow_ms):.0f} ms. It has {100 * wide.below(5.0):.1f} % of its energy below 5 Hz,"
        f" where the paper has {100 * paper.below(5.0):.1f} %: the paper's pulse is sharper than a"
        " radial pulse usually is, and harder to follow. Its standard deviation is"
        f" {deviation_n('wide'):.3f} of its height, the paper's {deviation_n('paper'):.3f}.",
    )


def _waves() -> Table:
    rows = tuple(
        (
            f"{preset}, wave {number}",
            f"{wave.amplitude:g}",
            f"{1e3 * wave.centre_s:g} ms",
            f"{1e3 * wave.width_s:g} ms",
        )
        for preset, waves in PRESETS.items()
        for number, wave in enumerate(waves, 1)
    )
    return Table(
        "A beat of both presets", ("wave", "amplitude", "centre", "width (deviation)"), rows
    )


def _shares(results: PaperResults) -> Table:
    spectra = results.spectra
    shares: tuple[Callable[[float], float], ...] = (
        spectra.paper.below,
        spectra.paper.below_by_trapezoids,
        spectra.mean_kept.below,
        spectra.mean_removed.below,
        spectra.wide.below,
    )
    rows = tuple(
        (
            f"{limit_hz:g} Hz",
            f"{100 * printed:.1f} %",
            *(f"{100 * share(limit_hz):.2f} %" for share in shares),
        )
        for limit_hz, printed in numbers.ENERGY_BELOW_HZ.items()
    )
    return Table(
        "Energy below a frequency",
        (
            "below",
            "paper",
            "ours",
            "ours by trapezoids",
            "beats alone, mean kept",
            "beats alone, mean removed",
            "wide",
        ),
        rows,
        "Mean kept: the Gaussians as they are, on zero. “wide” has the same constant and"
        " respiration as ours, in units of its own standard deviation.",
    )
