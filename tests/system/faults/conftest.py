import pytest


@pytest.fixture(autouse=True)
def always_goes_first(goes_first: None) -> None:
    """Keep other tests from delaying the nodes, which must be back within a second."""
