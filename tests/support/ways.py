"""Ways through a third machine between two nodes behind routers, as a page describes them."""

import getpass
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.support.doc_pages import blocks, commands
from tests.support.keyring import Keyring
from tests.support.nodes import RADIAL, process, read_json
from tests.support.routers import (
    OTHER_THIRD_ADDRESS,
    THIRD_ADDRESS,
    Sites,
    output_within,
    program_within,
    run_within,
)
from tests.support.tcp import answers
from tests.support.waiting import PATIENCE_S, until

PAGE = "docs/howto/behind_routers.md"
SSHD = "/usr/sbin/sshd"
SSHD_OPTIONS = """
Port 22
HostKey {folder}/host
AuthorizedKeysFile {folder}/login.pub
StrictModes no
PidFile none
"""


def nodes_keys(folder: Path) -> Keyring:
    """Return the key files of the two nodes: the wrist allows the finger."""
    keys = Keyring(folder)
    keys.allow("finger")
    return keys


@dataclass(frozen=True)
class Ends:
    """Options of the sensing node, and the address that the display connects to."""

    sensing: tuple[str, ...]
    connect: str


@contextmanager
def over_ssh(sites: Sites, folder: Path) -> Iterator[Ends]:
    """Run sshd on the third machine, and the page's ssh on the two others."""
    for name in ("host", "login"):
        run_within(sites.third, f"ssh-keygen -q -t ed25519 -N '' -f {folder / name}")
    Path(folder, "sshd").write_text(SSHD_OPTIONS.format(folder=folder), encoding="utf-8")
    known = "* " + Path(folder, "host.pub").read_text(encoding="ascii")
    Path(folder, "known").write_text(known, encoding="ascii")
    ours = (
        f" -F none -i {folder / 'login'} -o IdentitiesOnly=yes"
        f" -o UserKnownHostsFile={folder / 'known'} {getpass.getuser()}@"
    )
    typed = {where: command for where in "RL" for command in on_page("ssh", f"-{where} ")}
    with ExitStack() as stack:
        # The folder to which sshd confines itself before a login; a service makes it elsewhere.
        if not (confined := Path("/run/sshd")).exists():
            confined.mkdir(mode=0o755)
            stack.callback(confined.rmdir)
        stack.enter_context(program_within(sites.third, f"{SSHD} -D -e -f {folder / 'sshd'}"))
        until(lambda: answers(sites.third, "127.0.0.1", 22))
        for where, site, third in (
            ("R", sites.wrist, THIRD_ADDRESS),
            ("L", sites.finger, OTHER_THIRD_ADDRESS),
        ):
            command = typed[where].replace(" THIRD", ours + third)
            stack.enter_context(program_within(site, command))
        until(lambda: answers(sites.third, "127.0.0.1", 5656))
        until(lambda: answers(sites.finger, "127.0.0.1", 5656))
        yield Ends(("--bind", "tcp://127.0.0.1:5555"), "tcp://localhost:5655")


@contextmanager
def over_wireguard(sites: Sites, folder: Path) -> Iterator[Ends]:
    """Write the page's configurations, and bring WireGuard up on the three machines."""
    third, other = (
        block.text for block in blocks() if (block.page, block.language) == (PAGE, "text")
    )
    configured = {
        "third": (sites.third, third),
        "wrist": (sites.wrist, other.replace("Endpoint = THIRD", f"Endpoint = {THIRD_ADDRESS}")),
        "finger": (
            sites.finger,
            other.replace("Endpoint = THIRD", f"Endpoint = {OTHER_THIRD_ADDRESS}")
            .replace("10.9.0.2", "10.9.0.3")
            .replace("WRIST", "FINGER"),
        ),
    }
    words = {}
    for name in configured:
        secret = output_within(sites.third, "wg genkey")
        words[f"{name.upper()}_SECRET"] = secret
        words[f"{name.upper()}_PUBLIC"] = output_within(sites.third, "wg pubkey", secret)
    (up,) = on_page("wg-quick", "up")
    with ExitStack() as stack:
        for name, (site, text) in configured.items():
            for word, value in words.items():
                text = text.replace(word, value)
            # The kernel's, or the process in its place, has one interface of a name.
            path = folder / f"wg-{name}.conf"
            path.write_text(text, encoding="utf-8")
            path.chmod(0o600)
            run_within(site, up.replace("./wg0.conf", str(path)))
            stack.callback(run_within, site, f"wg-quick down {path}")
        yield Ends(("--bind", "tcp://10.9.0.2:5555"), "tcp://10.9.0.2:5555")


Way = Callable[[Sites, Path], AbstractContextManager[Ends]]
WAYS: dict[str, tuple[Way, tuple[str, ...], str]] = {
    "ssh": (over_ssh, ("ssh", SSHD), "openssh-client, openssh-server"),
    "WireGuard": (over_wireguard, ("wg", "wg-quick"), "wireguard-tools, wireguard-go"),
}


def missing(name: str) -> str | None:
    """Return why a way cannot be tried here; None where it can."""
    _, programs, packages = WAYS[name]
    if absent := [program for program in programs if shutil.which(program) is None]:
        return f"needs {' and '.join(absent)} (Debian: {packages})"
    return None


def on_page(program: str, part: str) -> list[str]:
    """Return the page's commands of a program that contain a part."""
    found = [c for block in blocks() if block.page == PAGE for c in commands(block)]
    return [c for c in found if re.match(rf"{program}\b", c) and part in c]


def play(
    sites: Sites, ends: Ends, keys: Keyring, folder: Path, seconds: float
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Run both nodes; return the summaries of the sensing node and of the display."""
    sensed, played = folder / "sensed.json", folder / "played.json"
    with ExitStack() as stack:
        with sites.finger.entered():
            display = stack.enter_context(
                process(
                    *("display_node.cli", str(RADIAL), "--no-screen", "--once"),
                    *("--connect", ends.connect, "--json", str(played)),
                    *("--key", keys.path("finger"), "--peer", keys.path("wrist", "pub")),
                )
            )
        with sites.wrist.entered():
            sensing = stack.enter_context(
                process(
                    *("sensing_node.cli", str(RADIAL), "--seconds", str(seconds)),
                    *(*ends.sensing, "--key", keys.path("wrist"), "--json", str(sensed)),
                )
            )
        assert sensing.wait(seconds + 2 * PATIENCE_S) == 0
        assert display.wait(PATIENCE_S) == 0
    return read_json(sensed), read_json(played)
