import pytest


@pytest.fixture(autouse=True)
def always_goes_first(goes_first: None) -> None:
    """The second within which the pulse is back is the nodes', not the other tests'."""
