from pathlib import Path

import pytest

from tests.support.keyring import Keyring


@pytest.fixture
def keyring(tmp_path: Path) -> Keyring:
    """Return keys of which the sensing node, "wrist", allows that of "finger"."""
    keyring = Keyring(tmp_path / "keys")
    keyring.allow("finger")
    return keyring
