import os
from pathlib import Path

import pytest

from protocol import errors
from protocol.security.link_keys import KeyOptions
from tests.support.keyring import Keyring

FAR, NEAR = "tcp://192.0.2.1:5555", "tcp://127.0.0.1:5555"


@pytest.fixture
def keyring(tmp_path: Path) -> Keyring:
    return Keyring(tmp_path / "keys")


@pytest.fixture
def own(keyring: Keyring) -> Path:
    return Path(keyring.path("wrist"))


@pytest.fixture
def peer(keyring: Keyring) -> Path:
    return Path(keyring.path("finger", "pub"))


@pytest.mark.parametrize("address", [FAR, "tcp://*:5555", "tcp://wrist.example:5555"])
def test_a_link_beyond_this_machine_requires_keys_or_insecure(address: str) -> None:
    with pytest.raises(
        errors.ProtectionError, match=r"telepulse keys new NAME.*--key.*--insecure"
    ) as one:
        KeyOptions().server(address)
    assert str(one.value).startswith(address)
    assert KeyOptions(insecure=True).server(address) is None
    if "*" not in address:
        with pytest.raises(errors.ProtectionError, match=r"--key .* --peer .*--insecure"):
            KeyOptions().client(NEAR, address)
        assert KeyOptions(insecure=True).client(NEAR, address) is None


@pytest.mark.parametrize("address", [NEAR, "tcp://localhost:5555", "tcp://[::1]:5555", "ipc://x"])
def test_on_this_machine_keys_are_optional(
    address: str, keyring: Keyring, own: Path, peer: Path
) -> None:
    assert KeyOptions().server(address) is None
    assert KeyOptions().client(address) is None
    keyring.allow("finger")
    served = KeyOptions(own).server(address)
    assert served is not None
    allowed = [public.name for public in served.allow_list.listed.values()]
    assert (served.pair.name, allowed) == ("wrist", ["finger"])
    client = KeyOptions(own, peer).client(address)
    assert client is not None
    assert (client.pair.name, client.server_key.name) == ("wrist", "finger")


def test_conflicting_options_of_keys_are_refused(own: Path, peer: Path, tmp_path: Path) -> None:
    for call, reason in (
        (lambda: KeyOptions(own, insecure=True).server(FAR), "--insecure does without keys"),
        (lambda: KeyOptions(own, peer, insecure=True).client(FAR), "--insecure does without keys"),
        (lambda: KeyOptions(own, insecure=True).telemetry_client(FAR), "--insecure does without"),
        (lambda: KeyOptions(peer=peer, insecure=True).client(FAR), "--peer is given: choose one"),
        (lambda: KeyOptions(own).client(FAR), "needs the other node's public"),
        (lambda: KeyOptions(peer=peer).client(FAR), "needs this node's own key"),
        (lambda: KeyOptions(allow=peer).server(NEAR), "needs this node's own key"),
        (lambda: KeyOptions(own, allow=tmp_path / "no").server(FAR), "there is no such file"),
        (lambda: KeyOptions(own, allow=peer).telemetry_server(NEAR), "beyond this machine"),
    ):
        with pytest.raises(errors.ProtectionError, match=reason) as caught:
            call()
        assert "\n" not in str(caught.value)


def test_key_files_and_addresses_are_checked_at_once(own: Path, peer: Path) -> None:
    with pytest.raises(errors.KeyFileError, match="give the secret one"):
        KeyOptions(peer).server(FAR)
    with pytest.raises(errors.KeyFileError, match="never leaves its machine"):
        KeyOptions(own, own).client(FAR)
    own.with_name("allowed").write_text("nonsense\n", encoding="utf-8")
    with pytest.raises(errors.KeyFileError, match="line 1"):
        KeyOptions(own).server(FAR)
    with pytest.raises(errors.AddressError, match="not an address"):
        KeyOptions().client("wrist:5555")


def test_the_links_of_a_command_share_files_that_are_read_once(own: Path, peer: Path) -> None:
    links = KeyOptions(own, peer)
    towards = links.client(FAR)
    own.unlink()
    peer.unlink()
    served = links.server(FAR)
    assert towards is not None
    assert served is not None
    assert served.pair is towards.pair
    assert links.forwarding_client(FAR) == towards


@pytest.mark.skipif(os.name != "posix", reason="links are POSIX")
def test_an_allow_list_that_cannot_be_reached_is_not_reported_as_missing(own: Path) -> None:
    path = own.with_name("loop")
    path.symlink_to(path)
    with pytest.raises(errors.KeyFileError, match="cannot read: Too many levels"):
        KeyOptions(own, allow=path).server(FAR)


def test_a_key_without_a_peer_is_that_of_the_displays_or_of_the_read_display(own: Path) -> None:
    links = KeyOptions(own)
    assert links.forwarding_client(NEAR) is None
    with pytest.raises(errors.ProtectionError, match="reaches beyond this machine"):
        links.forwarding_client(FAR)
    read = links.telemetry_client(FAR)
    assert read is not None
    assert read.server_key == read.pair.public
    assert links.telemetry_server(NEAR) is None
    assert links.telemetry_server(FAR) is not None
