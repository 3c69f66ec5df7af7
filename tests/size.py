"""Print the size of the product and of the tests, with their limits."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
PRODUCT = ("protocol", "pulse_sensors", "pulse_drives", "sensing_node", "display_node", "telepulse")
PRODUCT_LINES, PRODUCT_FILES, TEST_LINES = 30_000, 230, 26_000


def measure(*folders: str) -> tuple[int, int]:
    """Return lines and files of Python in the folders."""
    files = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files), len(files)


lines, files = measure(*PRODUCT)
print(f"product: {lines} lines in {files} files (at most {PRODUCT_LINES} in {PRODUCT_FILES})")
lines, files = measure("tests")
print(f"tests: {lines} lines in {files} files (at most {TEST_LINES} lines)")
