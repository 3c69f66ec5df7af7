from collections.abc import Iterator

from protocol.pieces import Pieces, complete


def test_work_is_done_a_piece_at_a_time_until_none_is_left() -> None:
    done = []

    def work() -> Iterator[None]:
        done.append(1)
        yield
        done.append(2)

    pieces = Pieces()
    assert not pieces.do_one()
    pieces.begin(work())
    assert (pieces.waiting, done) == (True, [])
    assert (pieces.do_one(), pieces.waiting, done) == (True, True, [1])
    assert (pieces.do_one(), pieces.waiting, done) == (True, False, [1, 2])
    assert not pieces.do_one()


def test_work_that_begins_anew_within_a_piece_is_kept() -> None:
    pieces, done = Pieces(), []

    def second() -> Iterator[None]:
        done.append("second")
        yield

    def first() -> Iterator[None]:
        pieces.begin(second())
        done.append("first")
        return
        yield

    pieces.begin(first())
    assert pieces.do_one()
    assert pieces.waiting
    pieces.finish()
    assert done == ["first", "second"]


def test_the_result_of_all_pieces() -> None:
    def summed():  # type: ignore[no-untyped-def]
        total = 1
        yield
        return total + 1

    assert complete(summed()) == 2
