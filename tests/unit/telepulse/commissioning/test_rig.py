import pytest

from display_node.drives.scene import Cia402Scene, TmclScene
from telepulse.commissioning.rig import can_frame_bits, check_line, exchange_s


def serial(baud: int, **keys: str) -> TmclScene:
    table = {"kind": "tmcl", "port": "/dev/ttyACM0", "baud": baud, **keys}
    return TmclScene.model_validate(table)


def test_a_datagram_takes_its_bits_each_way() -> None:
    assert exchange_s(serial(115_200)) / 2 == pytest.approx(0.78e-3, abs=2e-6)
    assert exchange_s(serial(9_600)) / 2 == pytest.approx(9.4e-3, abs=3e-5)


def test_a_can_frame_is_counted_with_all_its_stuffing() -> None:
    assert (can_frame_bits(0), can_frame_bits(8)) == (55, 135)
    bus = {"interface": "virtual", "channel": "0", "bitrate": "1 Mbit/s"}
    tmcl = TmclScene.model_validate({"kind": "tmcl", **bus})
    assert exchange_s(tmcl) == pytest.approx(250e-6)
    cia402 = Cia402Scene.model_validate({"kind": "cia402", **bus})
    assert exchange_s(cia402) == pytest.approx(410e-6)


@pytest.mark.parametrize(
    ("scene", "verdict"),
    [
        (serial(1_000_000), "ok"),
        (serial(115_200), "warn"),
        (serial(9_600), "fail"),
        (serial(9_600, period="20 ms", watchdog="80 ms"), "warn"),
    ],
)
def test_the_command_rate_that_the_line_allows_is_judged(scene: TmclScene, verdict: str) -> None:
    check = check_line(scene, 1e-3)
    assert check.verdict == verdict
    assert f"at most {1 / exchange_s(scene):.0f} commands a second" in check.found
    assert bool(check.reason) == (verdict != "ok")
