"""What this process may do, and how it is told that it may not."""

from pathlib import Path

from protocol.errors import RealtimeError

# From <linux/capability.h>.
CAP_IPC_LOCK, CAP_SYS_NICE = 14, 23
LIMITS_FILE = "/etc/security/limits.d/telepulse.conf"


class NotGrantedError(RealtimeError):
    """A measure is not granted. reason: why; advice: what to do about it."""

    def __init__(self, reason: str, advice: str) -> None:
        super().__init__(reason)
        self.reason = reason
        self.advice = advice


def capable(number: int) -> bool:
    """Whether this process has a capability of Linux."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("CapEff:"):
            return bool(int(line.split()[1], 16) >> number & 1)
    return False


def raise_limit(item: str, value: str, unit_key: str, docker: str) -> str:
    """How to raise a resource limit: at a login, in a systemd unit, in a container."""
    return (
        f'put "USER - {item} {value}" into {LIMITS_FILE} and log in anew'
        f" (systemd: {unit_key}; docker run {docker})"
    )
