"""Both nodes with an address for each of several links, which are cut one after the other."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import numpy as np

from telepulse.netem import NodesOutcome, run_nodes
from telepulse.simulation.link_scene import parse_link
from tests.support.felt_force import recording
from tests.support.nodes import RADIAL, assert_accounted, known
from tests.support.tcp import needs_emulator

# On the link's clock, which begins 1 s before the sensing node is started.
FIRST = parse_link("delay=20ms,jitter=3ms,cut.from=6s,cut.for=5s")
SECOND = parse_link("delay=20ms,jitter=3ms,cut.from=15s,cut.for=60min")
SECONDS = 17


def played(folder: Path, *links: str) -> tuple[NodesOutcome, float]:
    """Return both nodes' accounts, and the time in s in which the pulse was not felt between its
    first and its last instant at full strength."""
    scenes = {"first": FIRST, "second": SECOND}
    address = f"ipc://{folder}/{len(links)}"
    with recording(address) as felt:
        outcome = run_nodes(
            RADIAL, *(scenes[link] for link in links), seconds=SECONDS, telemetry=address
        )
    trace = felt.trace()
    first, last = np.flatnonzero(trace.scored)[[0, -1]]
    ticks_ns = np.diff(trace.now_ns[first : last + 1])
    return outcome, float(ticks_ns[~trace.scored[first + 1 : last + 1]].sum()) * 1e-9


@needs_emulator
def test_a_second_link_takes_over_when_one_is_cut(tmp_path: Path) -> None:
    with ThreadPoolExecutor() as pool:
        both = pool.submit(played, tmp_path, "first", "second")
        single = pool.submit(played, tmp_path, "first")
        (two, two_unfelt_s), (one, one_unfelt_s) = both.result(), single.result()

    for outcome in (two, one):
        samples = outcome.display.samples
        assert_accounted(asdict(samples))
        # The end of the stream arrived over the link that was left.
        accounted = known(samples.sent) + known(samples.before_joining)
        assert accounted == outcome.sensing.samples.sent
        assert outcome.sensing.samples.sent == 1000 * SECONDS
        # A frame may come over both connections where a second one took over.
        assert set(outcome.display.rejected) <= {"duplicate"}
        assert outcome.sensing.rejected == {}
        assert outcome.display.faults == []

    # For 5 s only the second link carried frames, at the end only the first.
    assert two.display.samples.lost == 0
    # On a busy machine both miss some of the pulse.
    assert two_unfelt_s < one_unfelt_s / 2
    first = list(two.display.frames.first.values())
    assert sum(first) == two.display.frames.received
    assert min(first) > 400
    assert 200 < known(two.display.frames.copies) < sum(first)

    # The frames of the cut are lost, and the pulse is felt again soon after.
    assert known(one.display.samples.lost) > 4000
    assert one.display.frames.first == {}
    assert one_unfelt_s > 4.5
