from telepulse.experiment.dialogue import Answer, Dialogue, Feel, Say, Stop


def test_each_interval_must_be_felt_before_an_answer() -> None:
    trial = Dialogue("abx", None)
    assert trial.press("1") == Say("feel A and B and X first")
    assert [trial.press(key) for key in "axb"] == [Feel("A", 1), Feel("X", 1), Feel("B", 1)]
    assert trial.press("a") == Feel("A", 2)
    assert trial.press("1") == Answer("A")
    assert trial.press("2") == Answer("B")


def test_intervals_are_felt_as_often_as_the_session_allows() -> None:
    trial = Dialogue("abx", 2)
    assert [trial.press("a") for _ in range(2)] == [Feel("A", 1), Feel("A", 2)]
    assert isinstance(trial.press("a"), Say)
    assert trial.press("x") == Feel("X", 1)


def test_a_rating_has_a_reference_and_five_keys() -> None:
    trial = Dialogue("rating", None)
    assert isinstance(trial.press("b"), Say)
    assert trial.press("5") == Say("feel A and X first")
    assert [trial.press(key) for key in "ax"] == [Feel("A", 1), Feel("X", 1)]
    assert [trial.press(key) for key in "15"] == [Answer(1), Answer(5)]
    assert isinstance(trial.press("6"), Say)


def test_q_stops() -> None:
    assert isinstance(Dialogue("abx", None).press("q"), Stop)
