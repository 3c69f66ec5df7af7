"""Lab Streaming Layer without a network, for tests."""

from pathlib import Path
from typing import Any

import pytest


def lsl_on_loopback(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return pylsl, restricted to the loopback interface here and in processes started from here.

    So neither multicast nor the streams of others matter. A process reads the configuration once,
    so it must be the same for all tests.
    """
    config = folder / "lsl_api.cfg"
    config.write_text(
        "[lab]\nKnownPeers = {127.0.0.1}\nSessionID = telepulse-test\n"
        "[multicast]\nResolveScope = machine\n[log]\nlevel = -3\n",
        encoding="utf-8",
    )
    monkeypatch.setenv("LSLAPICFG", str(config))
    return pytest.importorskip("pylsl")
