from pathlib import Path

import pytest

from protocol import errors
from protocol.cli_options import (
    client_keys,
    server_keys,
)
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
        server_keys(address, None, None, insecure=False)
    assert str(one.value).startswith(address)
    assert server_keys(address, None, None, insecure=True) is None
    if "*" not in address:
        with pytest.raises(errors.ProtectionError, match=r"--key .* --peer .*--insecure"):
            client_keys([NEAR, address], None, None, insecure=False)
        assert client_keys([NEAR, address], None, None, insecure=True) is None


@pytest.mark.parametrize("address", [NEAR, "tcp://localhost:5555", "tcp://[::1]:5555", "ipc://x"])
def test_on_this_machine_keys_are_optional(
    address: str, keyring: Keyring, own: Path, peer: Path
) -> None:
    assert server_keys(address, None, None, insecure=False) is None
    assert client_keys([address], None, None, insecure=False) is None
    served = server_keys(address, own, None, insecure=False)
    assert served is not None
    assert (served.own.name, served.allowed) == ("wrist", own.with_name("allowed"))
    client = client_keys([address], own, peer, insecure=False)
    assert client is not None
    assert (client.own.name, client.peer.name) == ("wrist", "finger")


def test_conflicting_options_of_keys_are_refused(own: Path, peer: Path, tmp_path: Path) -> None:
    for call, reason in (
        (lambda: server_keys(FAR, own, None, insecure=True), "--insecure does without keys"),
        (lambda: client_keys([FAR], own, peer, insecure=True), "--insecure does without keys"),
        (lambda: client_keys([FAR], own, None, insecure=False), "needs the other node's public"),
        (lambda: client_keys([FAR], None, peer, insecure=False), "needs this node's own key"),
        (lambda: server_keys(NEAR, None, peer, insecure=False), "needs this node's own key"),
        (lambda: server_keys(FAR, own, tmp_path / "no", insecure=False), "there is no such file"),
    ):
        with pytest.raises(errors.ProtectionError, match=reason) as caught:
            call()
        assert "\n" not in str(caught.value)


def test_key_files_and_addresses_are_checked_at_once(own: Path, peer: Path) -> None:
    with pytest.raises(errors.KeyFileError, match="give the secret one"):
        server_keys(FAR, peer, None, insecure=False)
    with pytest.raises(errors.KeyFileError, match="never leaves its machine"):
        client_keys([FAR], own, own, insecure=False)
    own.with_name("allowed").write_text("nonsense\n", encoding="utf-8")
    with pytest.raises(errors.KeyFileError, match="line 1"):
        server_keys(FAR, own, None, insecure=False)
    with pytest.raises(errors.AddressError, match="not an address"):
        client_keys(["wrist:5555"], None, None, insecure=False)
