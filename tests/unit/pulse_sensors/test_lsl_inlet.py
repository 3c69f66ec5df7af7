import pytest

from pulse_sensors.lsl_inlet import Chunk, LslDecoder
from tests.support.sample_blocks import Decoded, plain

NAN = float("nan")


def test_a_chunk_is_a_block_with_the_time_of_its_last_sample() -> None:
    decoder = LslDecoder((1,))
    first, second = Chunk([[9, 1], [9, 2]], [4.0, 4.001]), Chunk([[9, 3]], [4.002])
    assert plain(decoder.feed(first)) == [Decoded((1, 2), 4_001_000_000, restarted=True)]
    assert plain(decoder.feed(second)) == [Decoded((3,), 4_002_000_000)]
    decoder.reset()
    assert plain(decoder.feed(second)) == [Decoded((3,), 4_002_000_000, restarted=True)]


def test_samples_that_are_no_numbers_count_as_missing() -> None:
    decoder = LslDecoder((0,))
    blocks = decoder.feed(Chunk([[1], [NAN], [NAN], [2], [NAN]], [1.0, 2.0, 3.0, 4.0, 5.0]))
    blocks += decoder.feed(Chunk([[3]], [6.0]))
    assert plain(blocks) == [
        Decoded((1,), 10**9, restarted=True),
        Decoded((2,), 4 * 10**9, missing=2),
        Decoded((3,), 6 * 10**9, missing=1),
    ]
    assert decoder.rejected == {"not_finite": 3}


@pytest.mark.parametrize("time_s", [NAN, float("inf"), -1e300, 1e300])
def test_a_sample_with_an_impossible_time_is_rejected(time_s: float) -> None:
    decoder = LslDecoder((0,))
    assert decoder.feed(Chunk([[1]], [time_s])) == []
    assert decoder.rejected == {"not_finite": 1}
