from telepulse.relay.relay import SilenceDetector

S = 1_000_000_000
PATIENCE_NS = 2 * S


def test_where_nothing_is_asked_silence_is_no_fault() -> None:
    silence = SilenceDetector(PATIENCE_NS)
    assert not any(silence.lasts(t * S, asked=0, heard=0) for t in range(100))


def test_asked_and_not_answered_within_the_patience_it_is_dead() -> None:
    silence = SilenceDetector(PATIENCE_NS)
    assert not silence.lasts(5 * S, asked=1, heard=0)
    assert not silence.lasts(7 * S - 1, asked=9, heard=0)
    assert silence.lasts(7 * S, asked=9, heard=0)


def test_an_answer_ends_the_waiting_until_the_next_question() -> None:
    silence = SilenceDetector(PATIENCE_NS)
    silence.lasts(0, asked=1, heard=0)
    assert not silence.lasts(S, asked=1, heard=1)
    assert not silence.lasts(50 * S, asked=1, heard=1)
    assert not silence.lasts(51 * S, asked=2, heard=1)
    assert silence.lasts(53 * S, asked=3, heard=1)


def test_a_new_connection_has_all_the_patience() -> None:
    silence = SilenceDetector(PATIENCE_NS)
    silence.lasts(0, asked=1, heard=0)
    assert silence.lasts(2 * S, asked=2, heard=0)
    silence.begin_anew()
    assert not silence.lasts(2 * S, asked=3, heard=0)
    assert not silence.lasts(3 * S, asked=4, heard=0)
    assert silence.lasts(4 * S, asked=4, heard=0)


def test_a_cut_is_told_only_where_something_has_come_before() -> None:
    cut = SilenceDetector(PATIENCE_NS, once_heard=True)
    assert not any(cut.lasts(t * S, asked=t, heard=0) for t in range(9))
    cut.lasts(9 * S, asked=9, heard=1)
    assert not cut.lasts(10 * S, asked=10, heard=1)
    assert cut.lasts(12 * S, asked=11, heard=1)
    cut.begin_anew()
    assert not any(cut.lasts(t * S, asked=t, heard=1) for t in range(13, 20))
