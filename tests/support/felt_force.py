"""What holds of every fault: the pulse is back within a second, and the limits were kept."""

from collections.abc import Callable

from benchmarks.faults.finger import Finger

# The bound. On a machine that is busy with other things a display may miss it: of so many
# faults of one kind one must keep it, and all must be over within patience.
BACK_WITHIN_S = 1.0
TRIES = 5
PATIENCE_S = 20.0
FORCE_LIMIT_N = 2.5
# Of the scene, and what floating point adds to it.
SLEW_LIMIT_N_PER_S = 50.0 + 1e-6


def assert_back_within_a_second(finger: Finger, fault: Callable[[], int]) -> None:
    """fault: makes one and ends it; when it ended, in ns."""
    delays_s: list[float] = []
    while not delays_s or delays_s[-1] > BACK_WITHIN_S:
        assert len(delays_s) < TRIES, f"felt again only {delays_s} s after the fault's end"
        ended_ns = fault()
        felt_ns = finger.felt_steadily_from_ns(ended_ns, PATIENCE_S)
        assert felt_ns is not None
        delays_s.append((felt_ns - ended_ns) * 1e-9)


def assert_limits_kept(finger: Finger) -> None:
    """Neither force nor slew was beyond the scene's limits, from the first tick to the last."""
    force_n, wanted_n_per_s, _ = finger.peaks()
    # A host that stalls is felt less (display_node/control/stall_guard.py).
    assert 0.25 < force_n <= FORCE_LIMIT_N
    assert wanted_n_per_s <= SLEW_LIMIT_N_PER_S
