"""The wheel that users of every system install."""

import zipfile
from pathlib import Path

from tests.support.nodes import ROOT, run_python

NATIVE = (".so", ".pyd", ".dylib")
BUILT_WITHIN_S = 120


def test_the_wheel_is_pure_and_has_every_package_with_its_data(tmp_path: Path) -> None:
    options = ("--no-deps", "--no-build-isolation", "--quiet", "--wheel-dir", str(tmp_path))
    built = run_python("-m", "pip", "wheel", *options, str(ROOT), timeout=BUILT_WITHIN_S)
    assert built.returncode == 0, built.stderr
    (wheel,) = tmp_path.iterdir()
    assert wheel.name.endswith("-py3-none-any.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert not [name for name in names if name.endswith(NATIVE)]
    data = ("protocol/scenes/radial.toml", "telepulse/view/page.js", "telepulse/py.typed")
    assert {
        *data,
        "pulse_drives/cia402/cia402.eds",
        "telepulse/document.html",
        "telepulse/paper/page.md",
        "telepulse/firmware/host/host.cpp",
        "telepulse/firmware/telepulse_display/telepulse_display.ino",
    } <= {*names}
