"""Two namespaces and the relay between them, as one thing to use in a `with`."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass

from telepulse.emulator.namespace import EmulatorError, Namespace
from telepulse.emulator.relay import Carried
from telepulse.link import LinkScene

# Nobody but the two namespaces ever sees these addresses.
SENSING_ADDRESS, DISPLAY_ADDRESS = "10.77.0.1", "10.77.0.2"


@dataclass(slots=True)
class EmulatedLink:
    """A link between two namespaces.

    began_ns: when the link's time began, on this machine's monotonic clock. carried: what the
    relay has done, once the link has ended.
    """

    sensing: Namespace
    display: Namespace
    began_ns: int
    carried: Carried | None = None


@contextmanager
def emulate(scene: LinkScene, seed: int = 1) -> Iterator[EmulatedLink]:
    """A link as the scene says, within a `with`; several may stand side by side.

    The same seed gives the same chances, but which packet meets them is the kernel's affair.
    What was started in the namespaces is to be ended before. Raises EmulatorError.
    """
    with (
        closing(Namespace(SENSING_ADDRESS)) as sensing,
        closing(Namespace(DISPLAY_ADDRESS)) as display,
    ):
        relay = _start_relay((sensing.tun, display.tun), scene, seed)
        try:
            link = EmulatedLink(sensing, display, began_ns=_hear(relay)["began_ns"])
            yield link
            _end(relay)
            link.carried = Carried(**_hear(relay))
        finally:
            relay.kill()
            relay.communicate()


def _start_relay(tuns: tuple[int, int], scene: LinkScene, seed: int) -> subprocess.Popen[str]:
    arguments = (*map(str, tuns), scene.text(), str(seed))
    return subprocess.Popen(
        [sys.executable, "-m", "telepulse.emulator", *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        pass_fds=tuns,
        # Ctrl-C is for the caller, who ends the relay.
        start_new_session=True,
    )


def _hear(relay: subprocess.Popen[str]) -> dict[str, int]:
    """The next line that the relay says. Raises EmulatorError."""
    assert relay.stdout is not None
    line = relay.stdout.readline()
    if not line:
        _, errors = relay.communicate()
        last = errors.strip().splitlines()[-1:] or ["it said nothing"]
        raise EmulatorError(f"the relay of the emulated link ended: {last[0]}")
    table: dict[str, int] = json.loads(line)
    return table


def _end(relay: subprocess.Popen[str]) -> None:
    assert relay.stdin is not None
    relay.stdin.close()
    # So that communicate, later, does not flush what is closed.
    relay.stdin = None
