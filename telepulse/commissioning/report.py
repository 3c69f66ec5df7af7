"""What a bench check found, as tables and plots."""

from typing import TYPE_CHECKING

import numpy as np

from telepulse.commissioning.actuator_check import Actuator
from telepulse.commissioning.identification import NAMES
from telepulse.commissioning.response import respond, step_response
from telepulse.commissioning.run import BenchFindings
from telepulse.commissioning.sensor_check import SensorRecord
from telepulse.commissioning.tuning import report_design
from telepulse.reports.document import Chapter, Plot, Report, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_UNITS = {"m": (1.0, ""), "c": (1.0, ""), "k": (1.0, ""), "latency": (1e3, " ms")}


def report_bench(name: str, findings: BenchFindings) -> Report:
    """The report of a bench check."""
    rows = tuple(
        (part, check.name, check.found, check.verdict, check.reason)
        for part, check in findings.checks
    )
    modelled = ": its models, as it names no [display.drive]" if findings.modelled else ""
    checks = Table(f"bench of {name}{modelled}", ("part", "check", "found", "verdict", "why"), rows)
    still = tuple(_still_plot(part, heard) for part, heard in findings.still.items())
    chapters = [Chapter("Checks", tables=(checks,), plots=still)]
    if findings.actuator is not None:
        chapters.append(_actuator_chapter(findings.actuator))
    if findings.designs is not None:
        chapters += report_design(f"{name}, as identified", *findings.designs).chapters
    return Report(f"Bench of {name}", tuple(chapters))


def _actuator_chapter(actuator: Actuator) -> Chapter:
    found = actuator.identified
    rows = []
    for name, value, within in zip(NAMES, found.values, found.within, strict=True):
        scale, unit = _UNITS[name]
        told = "not told by the record" if name in found.untold else ""
        rows.append((name, f"{value * scale:.4g}{unit}", f"{within * scale:.2g}{unit}", told))
    rows.append(("delay of slow changes, latency + c/k", f"{found.delay_s * 1e3:.3g} ms", "", ""))
    if "m" not in found.untold:
        answer = step_response(found.model)
        rows += [
            ("resonance", f"{found.model.resonance_hz:.4g} Hz", "", ""),
            ("damping ζ", f"{found.model.damping:.3g}", "", ""),
            ("rise, 10 to 90 %", f"{answer.rise_s * 1e3:.3g} ms", "", ""),
            ("overshoot", f"{answer.overshoot * 100:.0f} %", "", ""),
            ("settling to 2 %", f"{answer.settling_s * 1e3:.3g} ms", "", ""),
        ]
    table = Table(
        "actuator, g(s) = 1 / (m s² + c s + k) (eq 22)",
        ("", "identified", "± (95 %)", ""),
        tuple(rows),
        note=_INPUT[actuator.contact is None],
    )
    return Chapter("Actuator", tables=(table,), plots=(_stairs_plot(actuator),))


_INPUT = {
    True: "from the voltage to the force; the film's filter is taken out",
    False: "from the force that the commanded place presses with at rest, by the contact found"
    " here, to the force felt: c in s, m in s²; the film's filter is taken out",
}


def _stairs_plot(actuator: Actuator) -> Plot:
    def draw(figure: "Figure") -> None:
        at_s, force_n = actuator.pressed.film(actuator.pressed.stairs)
        fitted_n = respond(actuator.identified.model, actuator.told, at_s)
        fitted_n += actuator.identified.zero_n
        force, left = figure.subplots(2, sharex=True, height_ratios=(3, 1))
        force.plot(at_s, force_n, label="film")
        force.plot(at_s, fitted_n, "--", label="eq 22, fitted")
        force.set(ylabel="force in N")
        force.legend(loc="upper left")
        left.plot(at_s, 1e3 * (force_n - fitted_n))
        left.set(xlabel="time in s", ylabel="left over, mN")

    return Plot("stairs", "The staircase: what the film said, and the fitted model.", draw)


def _still_plot(part: str, heard: SensorRecord) -> Plot:
    def draw(figure: "Figure") -> None:
        from scipy.signal import welch

        rate_hz = 1e9 / float(np.diff(heard.taken_ns).mean())
        count = min(len(heard.force_n), 1024)
        frequency_hz, density = welch(heard.force_n, rate_hz, nperseg=count)
        axes = figure.subplots()
        axes.semilogy(frequency_hz[1:], 1e3 * np.sqrt(np.maximum(density[1:], 1e-24)))
        axes.set(xlabel="frequency in Hz", ylabel="noise in mN/√Hz")

    return Plot(f"noise-{part}", f"Noise of the {part}'s sensor while nothing presses.", draw)
