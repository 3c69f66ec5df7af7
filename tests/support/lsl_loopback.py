"""Lab Streaming Layer without a network, for tests."""

from pathlib import Path
from typing import Any

import pytest


def lsl_on_loopback(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """pylsl, here and in processes started from here: loopback alone, and no multicast.

    Neither may be there, nor anybody else's streams. A process reads the configuration once: it
    must be the same for all tests.
    """
    config = folder / "lsl_api.cfg"
    config.write_text(
        "[lab]\nKnownPeers = {127.0.0.1}\nSessionID = telepulse-test\n"
        "[multicast]\nResolveScope = machine\n[log]\nlevel = -3\n",
        encoding="utf-8",
    )
    monkeypatch.setenv("LSLAPICFG", str(config))
    return pytest.importorskip("pylsl")
