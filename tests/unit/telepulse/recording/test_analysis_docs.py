import re
from pathlib import Path

import pytest

from telepulse.recording.edf import export_edf
from telepulse.recording.export import export_csv, export_parquet
from tests.support.nodes import ROOT
from tests.support.recordings import record

PRINTS = {
    "csv": r"3000 ticks, 0\.\d{3} mN off at most\n",
    "parquet": r"2995 samples, 0\.\d{4} to 0\.\d{4} N\n",
    "mcap.reader": r"\d+ session 'radial pulse', session 1\n\d+ begin the recording\n(?s:.*)",
    "edfio": r"Force pulse 1000\.0 Hz .* at most\nForce felt (?s:.*) s state: ended.*\n",
}
BLOCKS = re.findall(
    r"```python\n(.*?)```", (ROOT / "docs/analysis.md").read_text(encoding="utf-8"), re.DOTALL
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording")
    path = folder / "pulse.mcap"
    record(path, 3)
    export_csv(path, folder / "pulse")
    export_parquet(path, folder / "pulse.parquet")
    export_edf(path, folder / "pulse.edf")
    return folder


@pytest.mark.parametrize(("library", "prints"), PRINTS.items())
def test_the_code_that_loads_each_format_does_it(
    library: str,
    prints: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (code,) = (
        block
        for block in BLOCKS
        if re.search(rf"(import|from) {library}\b", block)
        or re.search(rf"from pyarrow import {library}\b", block)
    )
    monkeypatch.chdir(folder)
    exec(code, {})
    assert re.fullmatch(prints, capsys.readouterr().out)


def test_every_block_is_tried() -> None:
    assert len(BLOCKS) == len(PRINTS)
