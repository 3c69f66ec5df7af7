import platform
import subprocess
from typing import Any

import pytest

from protocol import provenance


@pytest.fixture(autouse=True)
def no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no unit test start a process; a provenance would run git and uname."""

    def refuse(_: object, command: Any, *args: Any, **options: Any) -> None:
        raise AssertionError(f"a unit test starts a process: {command}")

    monkeypatch.setattr(provenance, "_commit", lambda: None)
    monkeypatch.setattr(platform, "platform", lambda: "a platform")
    monkeypatch.setattr(subprocess.Popen, "__init__", refuse)
