"""The sentence about the finger."""

import pytest

from display_node.drives.finger import FingerState, describe_finger
from display_node.drives.withdrawal import WithdrawalOutcome


@pytest.mark.parametrize(
    ("state", "sentence"),
    [
        (FingerState(0.245), "pressed with 245 mN"),
        (FingerState(0.003), "not pressed"),
        (FingerState(0.245, measured_by="model"), "pressed with 245 mN (model)"),
        (FingerState(None, 3.2), "force unknown since 3 s"),
        (
            FingerState(0.245, outcome=WithdrawalOutcome.UNDER_WAY),
            "pressed with 245 mN, withdrawing",
        ),
        (FingerState(0.0, outcome=WithdrawalOutcome.WITHDRAWN), "withdrawn"),
        (
            FingerState(
                0.0, measured_by="by the drive's position", outcome=WithdrawalOutcome.WITHDRAWN
            ),
            "withdrawn",
        ),
        (
            FingerState(None, 3.0, outcome=WithdrawalOutcome.WITHDRAWN),
            "withdrawn by the drive's position, force unknown since 3 s",
        ),
        (
            FingerState(0.245, outcome=WithdrawalOutcome.WITHDRAWN),
            "pressed with 245 mN, although the drive reports the tip withdrawn",
        ),
        (
            FingerState(0.245, outcome=WithdrawalOutcome.UNCONFIRMED),
            "pressed with 245 mN, the drive does not confirm its withdrawal",
        ),
        (
            FingerState(0.5, outcome=WithdrawalOutcome.WRONG_WAY),
            "pressed with 500 mN, withdrawal stopped as it went towards the finger",
        ),
        (FingerState(0.245, answers=False), "pressed with 245 mN, the drive does not answer"),
        (
            FingerState(None, 3.0, outcome=WithdrawalOutcome.WITHDRAWN, answers=False),
            "force unknown since 3 s, the drive does not answer",
        ),
    ],
)
def test_it_claims_what_is_measured_and_no_more(state: FingerState, sentence: str) -> None:
    assert describe_finger(state) == sentence
