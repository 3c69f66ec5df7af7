import numpy as np

from display_node.press.learnt_beats import BIN_N, MOST_BEATS, OF_A_BIN, BeatLevels, BeatMemory
from display_node.press.respiration import FittedWave


def beat(number: int, force_n: float) -> BeatLevels:
    return BeatLevels(0.8 * number, 0.15, force_n, 0.0, (0.0, 0.1, 0.4, 0.6, 1.0))


def test_the_newest_beats_of_each_hold_down_are_kept() -> None:
    memory, random = BeatMemory(), np.random.default_rng(1)
    memory.add(beat(0, 0.3))
    for number in range(1, 500):
        memory.add(beat(number, float(random.choice([0.5, 0.9, 1.3]))))
    bins, counts = np.unique(np.rint(memory["hold_down_n"] / BIN_N), return_counts=True)
    # A force that was visited once, long ago, is still known.
    assert bins.tolist() == [6.0, 10.0, 18.0, 26.0]
    assert counts.tolist() == [1, OF_A_BIN, OF_A_BIN, OF_A_BIN]
    assert memory["at_s"][-1] == 0.8 * 499
    for number in range(500, 1500):
        memory.add(beat(number, float(random.uniform(0.2, 3.0))))
    assert len(memory.rows) == MOST_BEATS


def test_a_wave_is_expected_in_the_newest_beats_only_and_not_after_a_restart() -> None:
    memory = BeatMemory()
    for number in range(60):
        memory.add(beat(number, 0.05 * (number % 20)))
    wave = FittedWave(1.5, 0.0, 0.0, 0.08, 0.02)
    before = memory.rows[0].copy()
    memory.expect(wave)
    assert memory.rows[0] == before
    np.testing.assert_allclose(memory["expected"][-1], 0.08 * np.sin(1.5 * 0.8 * 59))
    assert memory["respiration"][-1] == memory["expected"][-1]
    memory.restart()
    memory.add(beat(0, 0.5))
    before = memory.rows[:-1].copy()
    memory.expect(wave)
    np.testing.assert_array_equal(memory.rows[:-1], before)
