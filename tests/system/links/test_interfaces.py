"""Several interfaces and both versions of IP: what is bound, announced, found and reached."""

from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from subprocess import Popen

import pytest

from protocol.security.allow_list import revoke
from protocol.sockets import Context
from tests.support.keyring import Keyring
from tests.support.live_display import await_state, await_status, subscribe
from tests.support.netem.namespace import Namespace
from tests.support.nodes import RADIAL, process
from tests.support.routers import cable, needs_routers, run_within
from tests.support.tcp import answers
from tests.support.waiting import PATIENCE_S

pytest.importorskip("zeroconf")
pytestmark = needs_routers


@dataclass(frozen=True)
class Machines:
    """A sensing machine with two interfaces, and a machine at each of them.

    beside: at "lan", with both versions of IP. beyond: at "other", with IPv6 alone.
    """

    wrist: Namespace
    beside: Namespace
    beyond: Namespace


@pytest.fixture
def machines() -> Iterator[Machines]:
    with ExitStack() as stack:
        wrist, beside, beyond = (stack.enter_context(closing(Namespace([]))) for _ in range(3))
        for one in (wrist, beside, beyond):
            with one.entered():
                # Else addresses can be used only after a second, when nobody else has claimed them.
                path = Path("/proc/sys/net/ipv6/conf/default/accept_dad")
                path.write_text("0", encoding="ascii")
        cable(wrist, "lan", "192.0.2.1/24", beside, "lan", "192.0.2.2/24")
        cable(wrist, "other", "2001:db8:2::1/64", beyond, "other", "2001:db8:2::2/64")
        for one, number in ((wrist, 1), (beside, 2)):
            run_within(
                one,
                f"ip address add 2001:db8:1::{number}/64 dev lan",
                f"ip address add fe80::{number}/64 dev lan",
            )
        yield Machines(wrist, beside, beyond)


def test_displays_join_by_ipv6_by_a_link_local_address_and_by_discovery(
    machines: Machines, context: Context, tmp_path: Path
) -> None:
    keys = Keyring(tmp_path / "keys")
    names = ("routed", "link-local", "discovered")
    for name in names:
        keys.allow(name)

    def display(site: Namespace, name: str, *where: str) -> Popen[str]:
        own = ("--key", keys.path(name), "--peer", keys.path("wrist", "pub"))
        telemetry = ("--telemetry", f"ipc://{tmp_path / name}", "--no-screen")
        with site.entered():
            return stack.enter_context(
                process("display_node.cli", str(RADIAL), *where, *own, *telemetry)
            )

    with ExitStack() as stack:
        with machines.wrist.entered():
            arguments = ("--bind", "tcp://[::]:5555", "--key", keys.path("wrist"), "--announce")
            wrist = stack.enter_context(process("sensing_node.cli", str(RADIAL), *arguments))
        display(machines.beside, "routed", "--connect", "tcp://[2001:db8:1::1]:5555")
        display(machines.beside, "link-local", "--connect", "tcp://[fe80::1%lan]:5555")
        display(machines.beyond, "discovered", "--discover")
        screens = {name: subscribe(context, f"ipc://{tmp_path / name}") for name in names}
        for screen in screens.values():
            await_state(screen, "playing")
        while "announced as" not in (line := wrist.read_line(PATIENCE_S, from_stderr=True)):
            pass
        assert line.endswith(" at 192.0.2.1, 2001:db8:1::1, 2001:db8:2::1")
        # The connection of a revoked key is found by its address, which has an interface here.
        revoke(keys.allowed, "link-local")
        await_status(screens["link-local"], lambda status: "revoked" in status.summary["rejected"])
        await_state(screens["routed"], "playing")


def test_a_node_that_is_bound_to_one_interface_is_announced_and_reached_there_alone(
    machines: Machines,
) -> None:
    with ExitStack() as stack:
        with machines.wrist.entered():
            arguments = ("--bind", "tcp://[2001:db8:2::1]:5555", "--insecure", "--announce")
            wrist = stack.enter_context(process("sensing_node.cli", str(RADIAL), *arguments))
        while "announced as" not in (line := wrist.read_line(PATIENCE_S, from_stderr=True)):
            pass
        assert line.endswith(" at 2001:db8:2::1")
        assert answers(machines.beyond, "2001:db8:2::1", 5555)
        assert not answers(machines.beside, "2001:db8:1::1", 5555)
        assert not answers(machines.beside, "192.0.2.1", 5555)
