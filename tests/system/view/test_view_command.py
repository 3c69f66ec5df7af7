from pathlib import Path

from tests.support.keyring import Keyring
from tests.support.log_lines import refused
from tests.support.nodes import free_address, process, run, run_python
from tests.support.telemetry_publisher import publishing
from tests.support.waiting import PATIENCE_S

MODULE = "telepulse"
TELEMETRY = "tcp://127.0.0.1:5600"


def test_a_taken_port_is_refused_where_it_was_given() -> None:
    with process(MODULE, "view", free_address()) as first:
        port = first.read_line(3 * PATIENCE_S).rpartition(":")[2]
        assert f"127.0.0.1:{port}" in refused(MODULE, "view", TELEMETRY, "--port", port)
        # Without a wish, another port is found.
        other = run(MODULE, "view", free_address(), "--seconds", "0.5")
        assert other.returncode == 0
        assert other.stdout.startswith("page: http://127.0.0.1:")
        assert not other.stdout.endswith(f":{port}\n")


def test_without_bokeh_it_names_what_to_install() -> None:
    code = "import sys; sys.modules['bokeh'] = None; from telepulse.cli.main import main; main()"
    result = run_python("-c", code, "view", TELEMETRY)
    assert result.returncode == 2
    assert result.stderr == ("telepulse: Bokeh is missing; pip install 'telepulse[view]'\n")


def test_protected_telemetry_is_opened_by_the_displays_own_key(tmp_path: Path) -> None:
    keyring, address = Keyring(tmp_path), free_address()
    keyring.allow("wrist")
    with (
        publishing(address, keyring.server()) as publisher,
        process(MODULE, "view", address, "--key", keyring.path("wrist")) as page,
    ):
        # The publisher begins once an allowed key has subscribed to all topics.
        publisher.begin()
        assert page.poll() is None
