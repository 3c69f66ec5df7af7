import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq
from zmq.utils import z85

from protocol.errors import KeyFileError, OutputError
from protocol.security.keys import KeyPair, PublicKey, new_pair, read_pair, read_public

POSIX = pytest.mark.skipif(os.name != "posix", reason="modes are POSIX")


@pytest.fixture
def umask_0() -> Iterator[None]:
    kept = os.umask(0)
    yield
    os.umask(kept)


def test_a_pair_is_written_and_read_again(tmp_path: Path) -> None:
    secret, public = new_pair(tmp_path / "keys", "wrist")
    assert (secret, public) == (tmp_path / "keys" / "wrist.key", tmp_path / "keys" / "wrist.pub")
    pair = read_pair(secret)
    assert pair.name == "wrist"
    assert read_public(public) == pair.public
    assert pair.public.key == z85.decode(zmq.curve_public(z85.encode(pair.secret)))
    assert (
        public.read_text(encoding="utf-8")
        == f"telepulse-public-key wrist {pair.public.key.hex()}\n"
    )
    assert pair.secret.hex() not in public.read_text(encoding="utf-8")
    assert read_pair(new_pair(tmp_path / "keys", "finger")[0]).secret != pair.secret


@POSIX
@pytest.mark.usefixtures("umask_0")
def test_only_the_owner_may_ever_read_a_secret_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    modes = []
    opened = os.open

    def open_and_look(path: Path, flags: int, mode: int = 0o777) -> int:
        number = opened(path, flags, mode)
        status = os.fstat(number)
        modes.append((Path(path).suffix, stat.S_IMODE(status.st_mode), status.st_size))
        return number

    monkeypatch.setattr(os, "open", open_and_look)
    secret, public = new_pair(tmp_path / "keys", "wrist")
    assert modes == [(".key", 0o600, 0), (".pub", 0o644, 0)]
    assert stat.S_IMODE(secret.stat().st_mode) == 0o600
    assert stat.S_IMODE(public.stat().st_mode) == 0o644
    assert stat.S_IMODE(secret.parent.stat().st_mode) == 0o700


@pytest.mark.parametrize("there", ["wrist.key", "wrist.pub"])
def test_no_file_is_overwritten_and_no_half_of_a_pair_is_left(tmp_path: Path, there: str) -> None:
    (tmp_path / there).write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError, match="exists already"):
        new_pair(tmp_path, "wrist")
    assert [path.name for path in tmp_path.iterdir()] == [there]
    assert (tmp_path / there).read_text(encoding="utf-8") == "mine"


def test_a_symbolic_link_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "wrist.key").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OutputError, match="exists already"):
        new_pair(tmp_path, "wrist")
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize(
    "name", ["", ".", "..", ".hidden", "a/b", "../a", "a b", "a\n", "ä", "-a", "a" * 65]
)
def test_an_invalid_name_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(KeyFileError, match="not a name"):
        new_pair(tmp_path, name)
    assert list(tmp_path.iterdir()) == []


@POSIX
@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o602, 0o644, 0o777])
def test_a_secret_key_open_to_others_is_refused_with_a_remedy(tmp_path: Path, mode: int) -> None:
    secret, _ = new_pair(tmp_path, "wrist")
    secret.chmod(mode)
    with pytest.raises(KeyFileError, match=f"run: chmod 600 {secret}"):
        read_pair(secret)
    secret.chmod(0o400)
    assert read_pair(secret).name == "wrist"


def test_a_secret_and_a_public_key_are_not_confused(tmp_path: Path) -> None:
    secret, public = new_pair(tmp_path, "wrist")
    with pytest.raises(KeyFileError, match=r"never leaves its machine; give .* wrist\.pub") as one:
        read_public(secret)
    assert read_pair(secret).secret.hex() not in str(one.value)
    with pytest.raises(KeyFileError, match=r"is a public key; give the secret one, wrist\.key"):
        read_pair(public)


GOOD = f"telepulse-public-key wrist {'ab' * 32}\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "not one line"),
        ("\n", "not 'telepulse-public-key NAME KEY'"),
        (GOOD + GOOD, "not one line"),
        ("wrist " + "ab" * 32, "not 'telepulse-public-key NAME KEY'"),
        (GOOD.replace("public", "pubic"), "not 'telepulse-public-key NAME KEY'"),
        (GOOD.replace("wrist", "../wrist"), "its second word is no name of a key"),
        (GOOD.replace("wrist", "left wrist"), "not 'telepulse-public-key NAME KEY'"),
        (GOOD.replace("abab", "ab", 1), "not a key of 64"),
        (GOOD.replace("abab", "ababab", 1), "not a key of 64"),
        (GOOD.replace("abab", "abxb", 1), "not a key of 64"),
        (GOOD.replace("abab", "ab١b", 1), "not a key of 64"),
        (GOOD.replace("wrist", "wröst"), "its second word is no name of a key"),
        (GOOD + " " * 5000, "is not a file of keys"),
        ("\0" * 50, "not 'telepulse-public-key NAME KEY'"),
    ],
)
def test_a_file_without_a_key_is_refused(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "wrist.pub"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(KeyFileError) as caught:
        read_public(path)
    assert str(caught.value).startswith(str(path))
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_broken_secret_key_file_is_told_the_form_of_a_secret_key(tmp_path: Path) -> None:
    secret, _ = new_pair(tmp_path, "wrist")
    secret.write_text("nonsense\n", encoding="utf-8")
    with pytest.raises(KeyFileError, match="it is not 'telepulse-secret-key NAME KEY'"):
        read_pair(secret)


@pytest.mark.parametrize("end", ["", "\r\n", "  \n"])
def test_a_key_may_have_other_white_space_and_case(tmp_path: Path, end: str) -> None:
    path = tmp_path / "wrist.pub"
    path.write_bytes(("  " + GOOD.strip().replace("ab", "AB") + end).encode())
    assert read_public(path) == PublicKey("wrist", b"\xab" * 32)


def test_a_missing_or_unreadable_file_is_refused(tmp_path: Path) -> None:
    for path, reason in (
        (tmp_path / "none.key", "no such file; make keys by: telepulse keys new NAME"),
        (tmp_path, "it is a folder"),
    ):
        for read in (read_pair, read_public):
            with pytest.raises(KeyFileError, match=reason):
                read(path)


def test_an_impossible_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(KeyFileError, match="cannot make the folder"):
        new_pair(tmp_path / "file", "wrist")


def test_the_text_of_a_pair_hides_its_secret() -> None:
    pair = KeyPair("wrist", b"\xcd" * 32)
    assert "cd" not in repr(pair)
    assert "205" not in repr(pair)
