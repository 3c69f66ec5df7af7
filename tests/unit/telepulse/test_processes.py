from telepulse.processes import log_warnings

LOG = """\
10:00:00.000 INFO streaming on tcp://127.0.0.1:5555
10:00:01.000 WARNING metrics: neither keys nor encryption
10:00:02.000 ERROR fault: felt force above 0.1 N: check the film
display-node: ended at the fault 'felt force above 0.1 N': check the film
10:00:03.000 ERROR the recorder has ended with status 1
"""


def test_warnings_and_errors_of_a_process_are_logged_with_its_name(logged: list[str]) -> None:
    log_warnings("display node", LOG)
    # The fault is named where the run ends.
    assert logged == [
        "display node: metrics: neither keys nor encryption",
        "display node: the recorder has ended with status 1",
    ]
