from protocol.config.quantities import count_text


def test_one_is_singular_and_all_others_are_plural() -> None:
    assert [count_text(count, "sample") for count in (0, 1, 2)] == [
        "0 samples",
        "1 sample",
        "2 samples",
    ]
    assert count_text(1, "deadline miss", "deadline misses") == "1 deadline miss"
    assert count_text(5, "deadline miss", "deadline misses") == "5 deadline misses"
