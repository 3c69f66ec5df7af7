from collections.abc import Iterator
from typing import Any

import pytest
import zmq
from hypothesis import settings

from protocol.sockets import Context, Socket

# A busy machine must not fail a test.
settings.register_profile("telepulse", deadline=None)
settings.load_profile("telepulse")


@pytest.fixture
def context() -> Iterator[Context]:
    kept = []

    class Keeping(zmq.Context[Socket]):
        """Nobody else may keep a test's sockets, and one that is forgotten warns."""

        def socket(self, *args: Any, **options: Any) -> Socket:
            kept.append(super().socket(*args, **options))
            return kept[-1]

    context = Keeping()
    yield context
    context.destroy(linger=0)
