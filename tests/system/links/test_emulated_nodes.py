"""The two real nodes over real TCP on an emulated link."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path

import pytest

from telepulse.simulation.link_scene import parse_link
from tests.support.netem import NodesOutcome, run_nodes
from tests.support.nodes import RADIAL, assert_accounted, known
from tests.support.tcp import needs_emulator

LOSSY = parse_link("delay=20ms,jitter=3ms,loss=1%")
SECONDS = 10
# Delays on a busy host hide those of the link.
ATTEMPTS = 3


def balance(outcome: NodesOutcome) -> None:
    """Check that both accounts have each sample once, and that TCP has lost none."""
    samples = outcome.display.samples
    sent, before_joining = known(samples.sent), known(samples.before_joining)
    assert_accounted(asdict(samples))
    assert samples.lost == 0
    assert outcome.sensing.samples.sent == sent + before_joining == 1000 * SECONDS
    # It joined soon, so that there is something to account for.
    assert before_joining < 3000
    assert outcome.display.faults == []
    assert known(outcome.carried).lost > 0


def play(folder: Path, paths: int) -> NodesOutcome:
    """Run the default scene with frames of 10 ms."""
    scene = folder / f"{paths}.toml"
    text = RADIAL.read_text(encoding="utf-8").replace('batch = "5 ms"', 'batch = "10 ms"')
    assert 'batch = "10 ms"' in text
    scene.write_text(text.replace("[display]\n", f"[display]\npaths = {paths}\n"), "utf-8")
    return run_nodes(scene, LOSSY, seconds=SECONDS)


@needs_emulator
def test_over_three_connections_a_lost_packet_delays_no_frame(tmp_path: Path) -> None:
    for attempt in range(ATTEMPTS):
        (folder := tmp_path / str(attempt)).mkdir()
        with ThreadPoolExecutor() as pool:
            single, triple = pool.map(partial(play, folder), (1, 3))
        for outcome in (single, triple):
            balance(outcome)
        assert single.display.rejected == triple.display.rejected == {}
        # Two of three copies are not the first, and none is counted twice.
        frames = triple.display.frames
        assert 1.5 < known(frames.copies) / known(frames.received) <= 2
        # A lost packet costs a single connection at least a round trip more.
        single_p99_ms = known(single.display.one_way_delay_ms.p99)
        assert single_p99_ms > 2 * known(single.display.one_way_delay_ms.p50)
        if known(triple.display.one_way_delay_ms.p99) < single_p99_ms:
            return
    pytest.fail(f"three connections were no faster in {ATTEMPTS} attempts")
