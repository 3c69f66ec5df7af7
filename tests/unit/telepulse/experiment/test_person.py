from telepulse.experiment.person import Dialogue, EndSession, Hint, Present, Response


def test_each_interval_must_be_felt_before_an_answer() -> None:
    trial = Dialogue("abx", None)
    assert trial.press("1") == Hint("feel A and B and X first")
    assert [trial.press(key) for key in "axb"] == [
        Present("A", 1),
        Present("X", 1),
        Present("B", 1),
    ]
    assert trial.press("a") == Present("A", 2)
    assert trial.press("1") == Response("A")
    assert trial.press("2") == Response("B")


def test_intervals_are_felt_as_often_as_the_session_allows() -> None:
    trial = Dialogue("abx", 2)
    assert [trial.press("a") for _ in range(2)] == [Present("A", 1), Present("A", 2)]
    assert isinstance(trial.press("a"), Hint)
    assert trial.press("x") == Present("X", 1)


def test_a_rating_has_a_reference_and_five_keys() -> None:
    trial = Dialogue("rating", None)
    assert isinstance(trial.press("b"), Hint)
    assert trial.press("5") == Hint("feel A and X first")
    assert [trial.press(key) for key in "ax"] == [Present("A", 1), Present("X", 1)]
    assert [trial.press(key) for key in "15"] == [Response(1), Response(5)]
    assert isinstance(trial.press("6"), Hint)


def test_q_stops() -> None:
    assert isinstance(Dialogue("abx", None).press("q"), EndSession)
