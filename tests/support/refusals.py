"""What is refused in one line."""

from collections.abc import Callable
from typing import Any

import pytest


def refusal_of(
    error: type[Exception], call: Callable[..., object], *arguments: Any, **options: Any
) -> str:
    """Return the one line with which a call is refused."""
    with pytest.raises(error) as caught:
        call(*arguments, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)
