import pytest


@pytest.fixture(autouse=True)
def always_goes_first(goes_first: None) -> None:
    """A pty holds 4 kB: who is kept from reading it loses samples, as the other tests would do."""
