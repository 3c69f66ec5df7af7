"""Processor quota for other processes by cgroups of version 2 or 1, to emulate a slower host.

The kernel lets a process run for a share of each period and stops it for the rest, at any speed of
the processor. A slow processor has no such pauses, so that a quota is the harsher of the two.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

ROOT = Path("/sys/fs/cgroup")
# A quota is 1 ms at least. A tenth of the processor is then 1 ms of every 10 ms.
LEAST_QUOTA_US = 1_000


def unavailable() -> str | None:
    """Return the reason why processes cannot be limited here; None where they can."""
    parent = _parent()
    if parent is None:
        return f"no cgroup under {ROOT} limits processor time"
    group = parent / f"telepulse-{os.getpid()}-try"
    try:
        group.mkdir()
        group.rmdir()
    except OSError as error:
        return f"{group}: {error.strerror}; limiting processor time needs root"
    return None


@contextmanager
def limited(pids: Sequence[int], share: float) -> Iterator[None]:
    """Limit each process to a share of a core within a `with`, and end its real-time priority.

    The kernel does not limit threads at real-time priority. Raises OSError.
    """
    parent = _parent()
    if parent is None:
        raise OSError(unavailable())
    made: list[tuple[Path, int, Path]] = []
    try:
        for pid in pids:
            group = parent / f"telepulse-{os.getpid()}-{pid}"
            group.mkdir()
            made.append((group, pid, _group_of(pid, parent)))
            _set_quota(group, LEAST_QUOTA_US, round(LEAST_QUOTA_US / share))
            for thread in os.listdir(f"/proc/{pid}/task"):
                os.sched_setscheduler(int(thread), os.SCHED_OTHER, os.sched_param(0))
            (group / "cgroup.procs").write_text(str(pid), encoding="ascii")
        yield
    finally:
        for group, pid, before in made:
            # The process may have ended meanwhile.
            with suppress(OSError):
                (before / "cgroup.procs").write_text(str(pid), encoding="ascii")
            group.rmdir()


def _parent() -> Path | None:
    """Return the group in which groups with a quota can be made."""
    with suppress(OSError):
        if "cpu" in (ROOT / "cgroup.subtree_control").read_text(encoding="ascii").split():
            return ROOT
    for name in ("cpu", "cpu,cpuacct"):
        if (ROOT / name / "cpu.cfs_quota_us").exists():
            return ROOT / name
    return None


def _group_of(pid: int, parent: Path) -> Path:
    """Return the present group of a process in the hierarchy of `parent`."""
    lines = Path(f"/proc/{pid}/cgroup").read_text(encoding="utf-8").splitlines()
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if "cpu" in controllers.split(",") or (not controllers and parent == ROOT):
            return parent / path.lstrip("/")
    return parent


def _set_quota(group: Path, quota_us: int, period_us: int) -> None:
    if (group / "cpu.max").exists():
        (group / "cpu.max").write_text(f"{quota_us} {period_us}", encoding="ascii")
    else:
        (group / "cpu.cfs_period_us").write_text(str(period_us), encoding="ascii")
        (group / "cpu.cfs_quota_us").write_text(str(quota_us), encoding="ascii")
