from telepulse.relay import UnansweredDetector

S = 1_000_000_000
TIMEOUT_NS = 2 * S


def test_without_requests_silence_is_no_fault() -> None:
    silence = UnansweredDetector(TIMEOUT_NS)
    assert not any(silence.is_silent(t * S, requests=0, received=0) for t in range(100))


def test_a_request_without_an_answer_within_the_timeout_is_silence() -> None:
    silence = UnansweredDetector(TIMEOUT_NS)
    assert not silence.is_silent(5 * S, requests=1, received=0)
    assert not silence.is_silent(7 * S - 1, requests=9, received=0)
    assert silence.is_silent(7 * S, requests=9, received=0)


def test_an_answer_ends_the_timeout_until_the_next_request() -> None:
    silence = UnansweredDetector(TIMEOUT_NS)
    silence.is_silent(0, requests=1, received=0)
    assert not silence.is_silent(S, requests=1, received=1)
    assert not silence.is_silent(50 * S, requests=1, received=1)
    assert not silence.is_silent(51 * S, requests=2, received=1)
    assert silence.is_silent(53 * S, requests=3, received=1)


def test_a_new_connection_has_the_whole_timeout() -> None:
    silence = UnansweredDetector(TIMEOUT_NS)
    silence.is_silent(0, requests=1, received=0)
    assert silence.is_silent(2 * S, requests=2, received=0)
    silence.restart()
    assert not silence.is_silent(2 * S, requests=3, received=0)
    assert not silence.is_silent(3 * S, requests=4, received=0)
    assert silence.is_silent(4 * S, requests=4, received=0)


def test_a_cut_is_reported_only_after_something_was_received() -> None:
    cut = UnansweredDetector(TIMEOUT_NS, after_first_message=True)
    assert not any(cut.is_silent(t * S, requests=t, received=0) for t in range(9))
    cut.is_silent(9 * S, requests=9, received=1)
    assert not cut.is_silent(10 * S, requests=10, received=1)
    assert cut.is_silent(12 * S, requests=11, received=1)
    cut.restart()
    assert not any(cut.is_silent(t * S, requests=t, received=1) for t in range(13, 20))
