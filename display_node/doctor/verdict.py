"""Verdict on a host and its ticks. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from display_node.doctor.host import Host
from display_node.doctor.jitter import Ticks
from display_node.scoring.deadlines import ALARM_SHARE, GAP_NS

BARE, TOGETHER = "bare", "together"
IDLE, LOADED = "nothing", "load"
# Of the ticks beside a load, with all that is granted.
OK_MISSED = 1e-3
SLOW_WAKE_US = 100
STOLEN = 1e-2
QUICK_CLOCKS = ("tsc", "arch_sys_counter", "kvm-clock", "riscv_clocksource", "timebase")

Table = Mapping[tuple[str, str], Ticks]


@dataclass(frozen=True, slots=True)
class HostFindings:
    """ticks: by measure and what ran beside it; option: what to give --realtime, None where nothing
    is granted; refusals: lines; stolen: share of time that a hypervisor gave to others
    meanwhile."""

    tick_ns: int
    ticks: Table
    option: str | None
    refusals: Sequence[str]
    stolen: float


@dataclass(frozen=True, slots=True)
class HostVerdict:
    """status: ok, look or fail; reason: a line; advice: lines, the weightiest first."""

    status: str
    reason: str
    advice: list[str]


def judge(host: Host, findings: HostFindings) -> HostVerdict:
    """Judge whether this host keeps a loop on time, and what would help."""
    bare = findings.ticks[BARE, LOADED]
    best = findings.ticks.get((TOGETHER, LOADED), bare)
    share = best.missed / best.due if best.due else 1.0
    latest_ms = (best.late_us.maximum or 0.0) * 1e-3
    stood_still = latest_ms * 1e6 > GAP_NS
    status = "ok" if share <= OK_MISSED else "look" if share <= ALARM_SHARE else "fail"
    how = f"with --realtime {findings.option}" if best is not bare else "with no measure"
    reason = f"beside a load, {how}, {best.missed} of {best.due} ticks were missed"
    if best is not bare:
        reason += f" (bare {bare.missed} of {bare.due})"
    reason += f", the latest began {latest_ms:.1f} ms late"
    if stood_still:
        status = "fail"
        reason += f": longer than the watchdog of a drive ({GAP_NS * 1e-6:.0f} ms)"
    return HostVerdict(
        status,
        reason,
        [*_of_stolen_time(findings), *_of_host(host), *findings.refusals],
    )


def _of_stolen_time(findings: HostFindings) -> list[str]:
    if findings.stolen <= STOLEN:
        return []
    return [
        f"the hypervisor gave {findings.stolen:.1%} of the time to others: nothing set here"
        " helps against that; take a machine of its own, or pin its processors"
    ]


def _of_host(host: Host) -> list[str]:
    advice = []
    if host.quota is not None and host.quota < 2:
        advice.append(
            f"the control group stops this process when it has had {host.quota:g} processors'"
            " time: lift cpu.max (docker run without --cpus)"
        )
    if host.governors and host.governors != ["performance"]:
        advice.append(
            f"processors change their speed ({', '.join(host.governors)}):"
            " cpupower frequency-set -g performance"
        )
    if host.idle_us is not None and host.idle_us >= SLOW_WAKE_US:
        advice.append(
            f"a processor takes {host.idle_us} µs to wake from its deepest sleep:"
            " boot with processor.max_cstate=1, or cpupower idle-set -D 50"
        )
    if host.clocksource is not None and host.clocksource not in QUICK_CLOCKS:
        advice.append(f"each look at the clock is a slow one ({host.clocksource}, not tsc)")
    if not host.curve:
        advice.append("this ZeroMQ cannot encrypt: install pyzmq's own wheel, or libsodium")
    return advice
