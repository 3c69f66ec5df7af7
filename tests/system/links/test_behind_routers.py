"""A finger behind one router and a wrist behind another, by each way of the page."""

import socket
from pathlib import Path

import pytest

from tests.support.nodes import assert_accounted
from tests.support.routers import ROUTER_ADDRESS, behind_routers, needs_routers
from tests.support.ways import WAYS, missing, nodes_keys, play


@needs_routers
@pytest.mark.parametrize("name", WAYS)
def test_a_finger_behind_one_router_feels_a_wrist_behind_another(name: str, tmp_path: Path) -> None:
    if (reason := missing(name)) is not None:
        pytest.skip(reason)
    keys = nodes_keys(tmp_path)
    with behind_routers() as sites:
        # Neither router lets anybody in.
        with sites.finger.entered(), socket.socket() as caller:
            caller.settimeout(0.5)
            with pytest.raises(TimeoutError):
                caller.connect((ROUTER_ADDRESS, 5555))
        with WAYS[name][0](sites, tmp_path) as ends:
            sensed, played = play(sites, ends, keys, tmp_path, seconds=5)
    samples = played["samples"]
    assert_accounted(samples)
    assert samples["lost"] == 0
    assert samples["played"] > 1000
    assert samples["sent"] + samples["before_joining"] == sensed["samples"]["sent"]
