import pytest


@pytest.fixture(autouse=True)
def always_goes_first(goes_first: None) -> None:
    """Give the processes priority: a pty holds 4 kB, and a late reader loses samples."""
