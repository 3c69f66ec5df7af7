import errno
import os
import stat
from itertools import count
from pathlib import Path

import pytest

from protocol.errors import KeyFileError
from protocol.security.allow_list import AllowList, allow, read_allow_list, revoke
from protocol.security.keys import PublicKey
from tests.support.refusals import refusal_of

WRIST, FINGER = PublicKey("wrist", b"\x01" * 32), PublicKey("finger", b"\x02" * 32)
ADD_A_KEY = "telepulse keys allow FILE.pub adds a key"
SECONDS_NS = count(0, 1_000_000_000)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "allowed"


def test_keys_are_added_and_removed(path: Path) -> None:
    assert read_allow_list(path) == {}
    path.write_text("", encoding="utf-8")
    assert read_allow_list(path) == {}
    allow(path, WRIST)
    allow(path, FINGER)
    assert read_allow_list(path) == {WRIST.key: WRIST, FINGER.key: FINGER}
    revoke(path, "wrist")
    assert read_allow_list(path) == {FINGER.key: FINGER}
    revoke(path, "finger")
    assert read_allow_list(path) == {}


def test_every_key_of_a_name_is_removed_and_all_other_lines_stay(path: Path) -> None:
    second = PublicKey("wrist", b"\x03" * 32)
    path.write_text(f"# the ward\n\n{WRIST.line}\n  # spare\n{second.line}\n", encoding="utf-8")
    assert list(read_allow_list(path).values()) == [WRIST, second]
    allow(path, FINGER)
    revoke(path, "wrist")
    assert path.read_text(encoding="utf-8") == f"# the ward\n\n  # spare\n{FINGER.line}\n"


@pytest.mark.parametrize(
    ("public", "reason"),
    [
        (WRIST, "wrist is allowed already"),
        (PublicKey("wrist", FINGER.key), "another key of the name wrist"),
        (PublicKey("other", WRIST.key), "allows this key already, by the name wrist"),
    ],
)
def test_a_name_has_one_key_and_a_key_one_name(path: Path, public: PublicKey, reason: str) -> None:
    allow(path, WRIST)
    with pytest.raises(KeyFileError, match=reason):
        allow(path, public)
    assert read_allow_list(path) == {WRIST.key: WRIST}


def test_a_name_that_is_not_listed_cannot_be_revoked(path: Path) -> None:
    with pytest.raises(KeyFileError, match="it allows nobody"):
        revoke(path, "wrist")
    allow(path, WRIST)
    with pytest.raises(KeyFileError, match="does not allow finger; it allows wrist"):
        revoke(path, "finger")


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("nonsense", "line 2: it is not 'telepulse-public-key NAME KEY'"),
        (WRIST.line[:-1], "line 2: its last word is not a key"),
        (WRIST.line + " more", "line 2: it is not"),
        (WRIST.line.replace("public", "secret"), "line 2: a secret key, which never leaves"),
        ("\x00", "line 2: it is not"),
        (PublicKey("other", FINGER.key).line, "line 2: this key is on the list already"),
        ("ö", "line 2: it is not"),
        (f"# a ward\u2028{WRIST.line}\n{WRIST.line} 2", "line 3: it is not"),
        ("#" * 2_000_000, "is not a file of keys: it is longer than"),
    ],
)
def test_an_invalid_list_is_one_line_without_a_key(path: Path, line: str, reason: str) -> None:
    path.write_text(f"{FINGER.line}\n{line}\n", encoding="utf-8")
    for read in (read_allow_list, AllowList):
        text = refusal_of(KeyFileError, read, path)
        assert reason in text
        assert WRIST.key.hex()[:16] not in text


def test_a_comment_may_have_any_characters_and_ends_with_its_line(path: Path) -> None:
    comment = f"# Müller, 脉\u2028{WRIST.line}\x0b{WRIST.line}"
    path.write_text(f"{comment}\n{FINGER.line}\n", encoding="utf-8")
    assert read_allow_list(path) == {FINGER.key: FINGER}
    allow(path, PublicKey("thumb", b"\x03" * 32))
    revoke(path, "finger")
    assert path.read_text(encoding="utf-8").split("\n")[0] == comment
    assert [public.name for public in read_allow_list(path).values()] == ["thumb"]


def test_a_list_in_another_encoding_is_refused_with_its_line_and_a_remedy(path: Path) -> None:
    path.write_bytes(f"{FINGER.line}\n# Müller\n".encode("latin-1"))
    with pytest.raises(KeyFileError) as caught:
        read_allow_list(path)
    assert str(caught.value) == f"{path}, line 2: it is not UTF-8; save the file in that encoding"


@pytest.mark.skipif(os.name != "posix", reason="links and modes are POSIX")
def test_a_change_keeps_a_link_and_the_owner_and_mode_of_the_list(path: Path) -> None:
    """A node that reads the list by another path must not go on allowing a revoked key."""
    allow(path, WRIST)
    path.chmod(0o640)
    if os.geteuid() == 0:
        os.chown(path, 12_345, 54_321)
    before, link = path.stat(), path.with_name("link")
    link.symlink_to(path)
    node = AllowList(path)
    allow(link, FINGER)
    revoke(link, "wrist")
    assert link.is_symlink()
    assert node.poll(0) == [WRIST.key]
    after = path.stat()
    assert (after.st_mode, after.st_uid, after.st_gid) == (
        before.st_mode,
        before.st_uid,
        before.st_gid,
    )


@pytest.mark.skipif(os.name != "posix", reason="modes are POSIX")
def test_a_new_list_is_readable_whatever_a_person_s_default_mode_is(path: Path) -> None:
    mask = os.umask(0)
    try:
        allow(path, WRIST)
    finally:
        os.umask(mask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o644
    assert read_allow_list(path) == {WRIST.key: WRIST}


def test_a_folder_is_no_list_and_has_the_remedy_for_a_list(tmp_path: Path) -> None:
    line = refusal_of(KeyFileError, AllowList, tmp_path)
    assert line == f"{tmp_path}: it is a folder; give the file of an allow-list"


@pytest.mark.skipif(os.name != "posix", reason="modes are POSIX")
@pytest.mark.parametrize("mode", [0o664, 0o646, 0o666])
def test_a_list_that_others_may_write_is_refused_with_a_remedy(path: Path, mode: int) -> None:
    allow(path, WRIST)
    path.chmod(mode)
    with pytest.raises(KeyFileError, match=f"run: chmod go-w {path}"):
        read_allow_list(path)


def test_two_commands_do_not_undo_each_other(path: Path) -> None:
    allow(path, WRIST)
    lock = path.with_name("allowed.lock")
    lock.write_text("", encoding="utf-8")
    with pytest.raises(KeyFileError, match="another command is changing the list"):
        revoke(path, "wrist")
    assert read_allow_list(path) == {WRIST.key: WRIST}
    lock.unlink()
    revoke(path, "wrist")
    assert list(path.parent.iterdir()) == [path]


@pytest.fixture
def polled(path: Path) -> AllowList:
    allow(path, WRIST)
    allow(path, FINGER)
    return AllowList(path)


def run(polled: AllowList, seconds: int) -> list[bytes]:
    """Poll once a second of virtual time."""
    return [key for _ in range(seconds) for key in polled.poll(next(SECONDS_NS))]


def test_a_change_is_read_once(path: Path, polled: AllowList, logged: list[str]) -> None:
    assert run(polled, 3) == []
    revoke(path, "wrist")
    assert run(polled, 3) == [WRIST.key]
    assert list(polled.listed) == [FINGER.key]
    path.unlink()
    assert run(polled, 3) == [FINGER.key]
    wrist, finger = f"wrist (key {'01' * 8}...)", f"finger (key {'02' * 8}...)"
    assert logged == [
        f"{wrist} is no longer allowed",
        f"{path} allows nobody; {ADD_A_KEY}",
        f"{finger} is no longer allowed",
    ]
    assert [polled.describe(key) for key in (WRIST.key, FINGER.key)] == [wrist, finger]
    assert polled.describe(bytes(32)) == f"key {'00' * 32}"


def test_a_list_is_read_until_readable(path: Path, polled: AllowList, logged: list[str]) -> None:
    path.chmod(0o664)
    assert polled.cause_to_refuse(WRIST.key) is None
    assert run(polled, 1) == []
    assert polled.cause_to_refuse(WRIST.key) == "list_unreadable"
    path.write_text(f"{FINGER.line}\n", encoding="utf-8")
    assert run(polled, 5) == []
    assert len(polled.listed) == 2
    path.chmod(0o644)
    assert run(polled, 1) == [WRIST.key]
    causes = [polled.cause_to_refuse(key) for key in (FINGER.key, WRIST.key, bytes(32))]
    assert causes == [None, "revoked_key", "unknown_key"]
    assert len(logged) == 3
    assert "until it can be read no new peer may connect" in logged[0]
    assert logged[1:] == [f"{path} is read again", f"{WRIST} is no longer allowed"]


def test_a_list_that_cannot_be_opened_is_read_later(
    path: Path, polled: AllowList, monkeypatch: pytest.MonkeyPatch, logged: list[str]
) -> None:
    def no_descriptor(*_: object) -> None:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    revoke(path, "wrist")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", no_descriptor)
        assert run(polled, 2) == []
    assert "Too many open files" in logged[0]
    assert run(polled, 1) == [WRIST.key]


@pytest.mark.skipif(os.name != "posix", reason="links are POSIX")
def test_a_list_that_cannot_be_reached_is_unreadable_and_not_deleted(
    path: Path, polled: AllowList, logged: list[str]
) -> None:
    """`Path.exists` returns False here, and from Python 3.14 on for every other error too."""
    path.unlink()
    path.symlink_to(path)
    assert run(polled, 3) == []
    assert len(polled.listed) == 2
    assert "Too many levels of symbolic links" in logged[0]


def test_after_10_s_without_a_list_no_key_is_allowed(
    path: Path, polled: AllowList, logged: list[str]
) -> None:
    text = path.read_text(encoding="utf-8")
    path.write_text("nonsense\n", encoding="utf-8")
    assert run(polled, 10) == []
    assert set(run(polled, 1)) == {WRIST.key, FINGER.key}
    assert run(polled, 20) == []
    assert polled.listed == {}
    assert logged[1:] == [f"{path} could not be read for 10 s: all peers are cut off"]
    path.write_text(text, encoding="utf-8")
    assert run(polled, 1) == []
    assert len(polled.listed) == 2
