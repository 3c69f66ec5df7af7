import subprocess
import sys

import pytest

from protocol.host.process import FILES

PROGRAM = """
import resource
from protocol.host.process import allow_connections
resource.setrlimit(resource.RLIMIT_NOFILE, ({present}, {most}))
allow_connections()
print(*resource.getrlimit(resource.RLIMIT_NOFILE))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no such limit")
@pytest.mark.parametrize(
    ("present", "most", "then"), [(128, 10_000, FILES), (128, 256, 256), (9_000, 10_000, 9_000)]
)
def test_the_limit_of_open_files_is_raised_as_far_as_it_may_be(
    present: int, most: int, then: int
) -> None:
    program = PROGRAM.format(present=present, most=most)
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert result.stdout.split() == [str(then), str(most)]
