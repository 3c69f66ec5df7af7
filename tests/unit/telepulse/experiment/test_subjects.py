from telepulse.experiment.subjects import Action, Dialogue


def test_each_interval_must_be_felt_before_an_answer() -> None:
    trial = Dialogue("abx", None)
    assert trial.press("1") == Action(hint="feel A and B and X first")
    assert [trial.press(key) for key in "axba"] == [
        Action(present="A", nth=1),
        Action(present="X", nth=1),
        Action(present="B", nth=1),
        Action(present="A", nth=2),
    ]
    assert [trial.press(key) for key in "12"] == [Action(answer="A"), Action(answer="B")]


def test_intervals_are_felt_as_often_as_the_session_allows() -> None:
    trial = Dialogue("abx", 2)
    assert [trial.press("a") for _ in range(3)] == [
        Action(present="A", nth=1),
        Action(present="A", nth=2),
        Action(hint="A was felt 2 times; no more in this trial"),
    ]
    assert trial.press("x") == Action(present="X", nth=1)


def test_a_rating_has_a_reference_and_five_keys() -> None:
    trial = Dialogue("rating", None)
    for key in "b6":
        pressed = trial.press(key)
        assert pressed is not None
        assert pressed.hint.startswith("a: feel the direct touch.")
    assert trial.press("5") == Action(hint="feel A and X first")
    assert [trial.press(key) for key in "ax"] == [
        Action(present="A", nth=1),
        Action(present="X", nth=1),
    ]
    assert [trial.press(key) for key in "15"] == [Action(answer=1), Action(answer=5)]


def test_q_stops() -> None:
    assert Dialogue("abx", None).press("q") is None
