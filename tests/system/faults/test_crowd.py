"""Twenty displays on one stream, of which one feels it, eighteen listen and one never reads.

Eighteen are in one process and move no actuator: twenty real-time loops would take all cores.
"""

import json
from pathlib import Path
from subprocess import PIPE

from benchmarks.faults.hostile import deaf_subscriber, port_of
from benchmarks.faults.stage import staged, unaccounted
from protocol.host.child_process import ChildProcess
from tests.support.felt_force import PATIENCE_S, assert_limits_kept

LISTENERS = 18
PLAYED = 1000


def test_one_of_twenty_that_misbehaves_costs_the_others_nothing(tmp_path: Path) -> None:
    with staged(tmp_path) as stage:
        sensing, display, finger = stage.play()
        (address,) = stage.connect
        command = ("-m", "benchmarks.faults.many_displays", address, str(LISTENERS))
        with (
            deaf_subscriber(port_of(address)),
            ChildProcess("crowd", *command, stdout=PIPE) as crowd,
        ):
            assert crowd.read_line(PATIENCE_S) == "listening"
            stage.await_played(finger, PLAYED)
            sent, account = sensing.end(), display.account()
            output, _ = crowd.communicate(timeout=PATIENCE_S)
    accounts = json.loads(output)
    assert len(accounts) == LISTENERS
    for total, played, late, lost, before_joining in accounts:
        assert total + before_joining == sent.samples.sent
        assert total == played + late
        assert lost == 0
        assert total > 0
    assert unaccounted(sent, account) == 0
    assert account.samples.lost == 0
    assert account.faults == []
    assert_limits_kept(finger)
