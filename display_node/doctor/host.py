"""Properties of a host that matter to a real-time loop; they are read, never changed."""

import importlib.metadata
import os
import platform
import re
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import zmq

from protocol.host.process import spans

CPU = Path("/sys/devices/system/cpu")
CGROUP = Path("/sys/fs/cgroup")
PREEMPTION = re.compile(r"\bPREEMPT(?:_RT| RT|_DYNAMIC)?\b")
EXTRA = re.compile(r"([\w.-]+).*extra == ['\"]([\w-]+)['\"]")
# Extras that a node may need; the others are for reports and studies.
EXTRAS = ("sensors", "drives", "record")
SLOW_WAKE_US = 100
QUICK_CLOCKS = ("tsc", "arch_sys_counter", "kvm-clock", "riscv_clocksource", "timebase")
UNKNOWN = "not reported"


@dataclass(frozen=True, slots=True)
class Host:
    """Properties of a host; None or empty where they could not be read.

    cpus: numbers of the processors that this process may use. quota: number of processors whose
    whole time its control group allows. idle_us: time to wake from the deepest sleep. limits:
    resource limits of this process by name; None for no limit. realtime_share: share of a
    processor's time for threads with a real-time priority. extras: missing packages by extra.
    """

    system: str
    preemption: str | None = None
    virtual: list[str] = field(default_factory=list)
    cpus: list[int] = field(default_factory=list)
    isolated: str = ""
    quota: float | None = None
    governors: list[str] = field(default_factory=list)
    idle_us: int | None = None
    clocksource: str | None = None
    clock_resolution_ns: float = 0.0
    swap_kib: int = 0
    limits: dict[str, int | None] = field(default_factory=dict)
    realtime_share: float | None = None
    python: str = ""
    zeromq: str = ""
    curve: bool = False
    extras: dict[str, list[str]] = field(default_factory=dict)


def read_host() -> Host:
    """Read the properties that this host reports."""
    meminfo = kernel_text(Path("/proc/meminfo"))
    idle = [kernel_text(path) for path in CPU.glob("cpu0/cpuidle/state*/latency")]
    swap = re.search(r"^SwapTotal:\s+(\d+) kB", meminfo, re.MULTILINE)
    return Host(
        system=f"{platform.system()} {platform.release()} on {platform.machine()}",
        preemption=preemption_of(platform.version()),
        virtual=_virtual(),
        cpus=sorted(os.sched_getaffinity(0)) if sys.platform == "linux" else [],
        isolated=kernel_text(CPU / "isolated"),
        quota=_quota(),
        governors=sorted({kernel_text(path) for path in CPU.glob("cpu*/cpufreq/scaling_governor")}),
        idle_us=max((int(text) for text in idle if text.isdigit()), default=None),
        clocksource=kernel_text(CPU.parent / "clocksource/clocksource0/current_clocksource")
        or None,
        clock_resolution_ns=time.get_clock_info("monotonic").resolution * 1e9,
        swap_kib=int(swap[1]) if swap else 0,
        limits=_limits(),
        realtime_share=_realtime_share(),
        python=f"{platform.python_implementation()} {platform.python_version()}",
        zeromq=f"{zmq.zmq_version()}, pyzmq {zmq.pyzmq_version()}",
        curve=bool(zmq.has("curve")),
        extras=_missing(importlib.metadata.requires("telepulse") or []),
    )


def preemption_of(version: str) -> str | None:
    """Return the preemption model that a Linux kernel's version line names; None without one."""
    found = PREEMPTION.search(version)
    return found[0].replace(" ", "_") if found else None


def describe(host: Host) -> list[tuple[str, str]]:
    """Return the host as rows of a table, each a name and a text."""
    cpus = spans(frozenset(host.cpus)) or "any"
    if host.quota is not None:
        cpus += f", for the time of {host.quota:g}"
    if host.isolated:
        cpus += f", isolated {host.isolated}"
    power = list(host.governors)
    if host.idle_us is not None:
        power.append(f"{host.idle_us} µs to wake from the deepest sleep")
    share = UNKNOWN
    if host.realtime_share is not None:
        share = f"{host.realtime_share:.0%} of a processor for those with a priority"
    limits = []
    for name, limit in host.limits.items():
        shown = f"{limit / (1 << 20):g} MiB" if limit is not None and "MEM" in name else limit
        limits.append(f"{name} {'unlimited' if limit is None else shown}")
    missing = [f"{name} (without {', '.join(gone)})" for name, gone in host.extras.items() if gone]
    return [
        ("system", f"{host.system}, {host.preemption or 'preemption unknown'}"),
        ("inside", ", ".join(host.virtual) or "neither a virtual machine nor a container"),
        ("may run on", cpus),
        ("power", ", ".join(power) or UNKNOWN),
        ("clock", f"{host.clocksource or 'unknown'}, in {host.clock_resolution_ns:g} ns"),
        ("swap", f"{host.swap_kib >> 10} MiB" if host.swap_kib else "none"),
        ("limits", ", ".join(limits) or UNKNOWN),
        ("real-time share", share),
        ("python", host.python),
        ("zeromq", f"{host.zeromq}, {'CURVE' if host.curve else 'without CURVE'}"),
        ("extras", ", ".join(missing) or "all there"),
    ]


def advice_on(host: Host) -> Iterator[str]:
    """Yield advice on this host, the most effective first."""
    if host.quota is not None and host.quota < 2:
        yield (
            f"the control group stops this process when it has had {host.quota:g} processors'"
            " time: lift cpu.max (docker run without --cpus)"
        )
    if host.governors and host.governors != ["performance"]:
        yield (
            f"processors change their speed ({', '.join(host.governors)}):"
            " cpupower frequency-set -g performance"
        )
    if host.idle_us is not None and host.idle_us >= SLOW_WAKE_US:
        yield (
            f"a processor takes {host.idle_us} µs to wake from its deepest sleep:"
            " boot with processor.max_cstate=1, or cpupower idle-set -D 50"
        )
    if host.clocksource is not None and host.clocksource not in QUICK_CLOCKS:
        yield f"reading the clock is slow ({host.clocksource}, not tsc)"
    if not host.curve:
        yield "this ZeroMQ cannot encrypt: install pyzmq's own wheel, or libsodium"


def stolen() -> tuple[int, int]:
    """Return the time that a hypervisor took away, and the total time, of all processors.

    Both are in the kernel's units since its start; zeros where the kernel does not count them.
    """
    line = kernel_text(Path("/proc/stat")).partition("\n")[0].split()[1:9]
    return (int(line[7]), sum(map(int, line))) if len(line) == 8 else (0, 0)


def _virtual() -> list[str]:
    found = []
    if re.search(r"^flags\b.*\bhypervisor\b", kernel_text(Path("/proc/cpuinfo")), re.MULTILINE):
        found.append("a virtual machine")
    marks = (Path("/.dockerenv"), Path("/run/.containerenv"))
    if any(mark.exists() for mark in marks) or "container" in os.environ:
        found.append("a container")
    return found


def _quota() -> float | None:
    """Return the number of processors whose time a control group of either version allows."""
    for line in kernel_text(Path("/proc/self/cgroup")).splitlines():
        _, controllers, path = line.split(":", 2)
        if not controllers:
            quota, _, period = kernel_text(CGROUP / path.strip("/") / "cpu.max").partition(" ")
        elif "cpu" in controllers.split(","):
            folder = CGROUP / "cpu" / path.strip("/")
            quota, period = (kernel_text(folder / f"cpu.cfs_{x}_us") for x in ("quota", "period"))
        else:
            continue
        if quota.isdigit() and period.isdigit():
            return int(quota) / int(period)
    return None


def _realtime_share() -> float | None:
    kernel = Path("/proc/sys/kernel")
    runtime, period = (kernel_text(kernel / f"sched_rt_{key}_us") for key in ("runtime", "period"))
    if not period.isdigit():
        return None
    return 1.0 if runtime == "-1" else int(runtime) / int(period)


def _limits() -> dict[str, int | None]:
    if sys.platform == "win32":
        return {}
    import resource

    names = ("RTPRIO", "MEMLOCK", "NOFILE")
    numbers = {name: getattr(resource, f"RLIMIT_{name}", None) for name in names}
    found = {name: resource.getrlimit(n)[0] for name, n in numbers.items() if n is not None}
    return {name: None if n == resource.RLIM_INFINITY else n for name, n in found.items()}


def _missing(requirements: list[str]) -> dict[str, list[str]]:
    """Return the packages of each extra that are not installed."""
    missing: dict[str, list[str]] = {}
    for requirement in requirements:
        found = EXTRA.match(requirement)
        if found and found[2] in EXTRAS:
            gone = missing.setdefault(found[2], [])
            try:
                importlib.metadata.version(found[1])
            except importlib.metadata.PackageNotFoundError:
                gone.append(found[1])
    return missing


def kernel_text(path: Path) -> str:
    """Return the text of a file of the kernel; empty where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
