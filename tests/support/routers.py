"""Two machines behind routers that let nobody in, and a third machine that both can reach."""

import os
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.netem import unavailable
from tests.support.netem.namespace import Namespace

# Documentation networks (RFC 5737), which are nobody's.
THIRD_ADDRESS, OTHER_THIRD_ADDRESS = "203.0.113.1", "198.51.100.1"


# Outer address of the router before the wrist.
ROUTER_ADDRESS = "203.0.113.2"


@dataclass(frozen=True)
class Sites:
    """Namespaces: the wrist's machine, its router, the third machine, the finger's machine."""

    wrist: Namespace
    router: Namespace
    third: Namespace
    finger: Namespace


def run_within(namespace: Namespace, *commands: str) -> None:
    """Run commands in a namespace; each must succeed."""
    for command in commands:
        output_within(namespace, command)


def output_within(namespace: Namespace, command: str, text: str = "") -> str:
    """Run a command in a namespace with `text` as its input; return what it prints."""
    with namespace.entered():
        ended = subprocess.run(
            shlex.split(command), check=True, input=text, capture_output=True, encoding="utf-8"
        )
    return ended.stdout.strip()


@contextmanager
def program_within(namespace: Namespace, command: str) -> Iterator[None]:
    """Run a program in a namespace until the end of the `with`; its input stays open."""
    with namespace.entered():
        program = subprocess.Popen(shlex.split(command), stdin=subprocess.PIPE)
    try:
        yield
    finally:
        program.terminate()
        program.communicate()


@contextmanager
def behind_routers() -> Iterator[Sites]:
    """Make the three machines and the two routers, for the duration of a `with`.

    Either router translates addresses (NAT), and drops what nobody behind it has asked for. Skips
    the test on a kernel without such routers.
    """
    with ExitStack() as stack:
        try:
            sites = _connect(stack)
        except subprocess.CalledProcessError as error:
            pytest.skip(f"{' '.join(error.cmd)}: {error.stderr.strip()}")
        yield sites


def _connect(stack: ExitStack) -> Sites:
    wrist, router, third, other_router, finger = (
        stack.enter_context(closing(Namespace([]))) for _ in range(5)
    )
    cable(router, "outer", f"{ROUTER_ADDRESS}/24", third, "one", f"{THIRD_ADDRESS}/24")
    cable(other_router, "outer", "198.51.100.2/24", third, "two", f"{OTHER_THIRD_ADDRESS}/24")
    cable(wrist, "lan", "192.168.1.10/24", router, "inner", "192.168.1.1/24")
    cable(finger, "lan", "192.168.1.10/24", other_router, "inner", "192.168.1.1/24")
    run_within(wrist, "ip route add default via 192.168.1.1")
    run_within(finger, "ip route add default via 192.168.1.1")
    for one, beyond in ((router, THIRD_ADDRESS), (other_router, OTHER_THIRD_ADDRESS)):
        run_within(
            one,
            f"ip route add default via {beyond}",
            "iptables -t nat -A POSTROUTING -o outer -j MASQUERADE",
            "iptables -A FORWARD -i outer -m conntrack --ctstate NEW -j DROP",
            "iptables -A INPUT -i outer -m conntrack --ctstate NEW -j DROP",
        )
    for one in (router, third, other_router):
        with one.entered():
            Path("/proc/sys/net/ipv4/ip_forward").write_text("1", encoding="ascii")
    return Sites(wrist, router, third, finger)


def cable(one: Namespace, name: str, address: str, other: Namespace, *end: str) -> None:
    """Connect two namespaces by a pair of virtual Ethernet interfaces."""
    other_name, other_address = end
    path = f"/proc/{os.getpid()}/fd/{other.descriptor}"
    run_within(
        one,
        f"ip link add {name} type veth peer name {other_name} netns {path}",
        f"ip address add {address} dev {name}",
        f"ip link set {name} up",
    )
    run_within(
        other, f"ip address add {other_address} dev {other_name}", f"ip link set {other_name} up"
    )


def _missing() -> str | None:
    """Return which program is missing to make routers; None where none is."""
    if missing := [name for name in ("ip", "iptables") if shutil.which(name) is None]:
        return f"needs {' and '.join(missing)} (Debian: iproute2, iptables)"
    return unavailable()


reason = _missing()
needs_routers = pytest.mark.skipif(reason is not None, reason=str(reason))
