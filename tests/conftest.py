import importlib
import logging
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import zmq
from coverage import Coverage
from hypothesis import settings

from protocol.errors import ProcessError
from protocol.host.output import OUR_LOGGERS, StderrHandler
from protocol.sockets import Context, Socket
from telepulse.emulators import sketch
from tests.support.nodes import free_address

# A busy machine must not fail a test.
settings.register_profile("telepulse", deadline=None)
settings.load_profile("telepulse")

FIRST_NICENESS = -10
TESTS = Path(__file__).parent
# Minutes of computing, which a tracer would triple. Other tests cover what they run.
NOT_TRACED = (
    *("golden", "unit/telepulse", "unit/soak", "unit/documentation"),
    *("system/accuracy", "system/commissioning", "system/documentation"),
    *("system/experiment", "system/faults", "system/recording", "system/relay"),
    *("system/paper", "system/stability"),
    *("system/soak", "system/view", "unit/display_node/test_hardware.py"),
    "unit/display_node/control/test_controller.py",
    *("unit/pulse_drives/test_drive.py", "unit/display_node/reception/test_failover.py"),
)
# Left to `make test-all`, with what is in tests/system without the marker "smoke".
LATER = (
    # Tests of what tests, and of the code's form.
    *("unit/soak", "unit/documentation", "unit/telepulse/testing"),
    *("unit/test_class_names.py", "unit/test_clock_reads.py"),
    # Studies, comparisons with other libraries, and words on pages.
    *("unit/telepulse/view", "unit/telepulse/experiment"),
    *("unit/telepulse/paper", "unit/telepulse/test_document.py"),
    "unit/protocol/summary/test_figures.py",
    "unit/display_node/control/test_linear_loop.py",
    # Seconds each, of what quicker tests have in part.
    *("unit/display_node/test_announced_stream.py", "unit/display_node/test_hardware.py"),
    *("unit/display_node/test_process_stall.py", "unit/display_node/test_yielding_bench.py"),
    *("unit/display_node/prediction/test_announced.py", "unit/display_node/press/test_sweep.py"),
    "unit/display_node/prediction/test_r_wave_scores.py",
    "unit/display_node/scoring/test_tracking_error.py",
    "unit/sensing_node/sources/test_synthetic.py",
    *(
        "unit/telepulse/recording/test_signal_export.py",
        "unit/telepulse/recording/test_pressed_beats.py",
    ),
    "unit/telepulse/recording/test_recorded_beats.py",
    "unit/telepulse/recording/test_recorded_wrist.py",
    "unit/display_node/press/test_press_loop.py",
)
SYSTEM = "system"


def is_in(path: Path, *places: str) -> bool:
    return any(path.is_relative_to(TESTS / place) for place in places)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--quick", action="store_true", help="the tests of `make test` alone")


def pytest_configure(config: pytest.Config) -> None:
    """Compile kernels and sketch once, before workers and processes would each do so."""
    if not hasattr(config, "workerinput"):
        importlib.import_module("display_node.prediction.ensemble")
        if sketch.missing() is None:
            sketch.compiled()


def _skip_without_compiler() -> Iterator[Any]:
    """Skip a test of the emulated board where this machine cannot compile its sketch."""
    try:
        return (yield)
    except ProcessError as error:
        if str(error) == sketch.missing():
            pytest.skip(str(error))
        raise


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call() -> Iterator[Any]:
    return (yield from _skip_without_compiler())


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup() -> Iterator[Any]:
    return (yield from _skip_without_compiler())


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out with --quick, and do not even import, what `make test-all` has besides."""
    if not config.getoption("quick"):
        return None
    in_system = is_in(collection_path, SYSTEM) and collection_path.name.startswith("test_")
    if in_system and "pytest.mark.smoke" not in collection_path.read_text(encoding="utf-8"):
        return True
    return is_in(collection_path, *LATER) or None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what lies in tests/system; keep the smoke tests of it alone with --quick."""
    for item in items:
        if is_in(item.path, SYSTEM):
            item.add_marker(pytest.mark.system)
    if config.getoption("quick"):
        items[:] = [
            item
            for item in items
            if not is_in(item.path, SYSTEM) or item.get_closest_marker("smoke")
        ]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Run a test of `NOT_TRACED`, and its fixtures, without coverage.

    pytest-cov's marker `no_cover` has no effect in a worker of pytest-xdist, where pytest-cov
    starts two measurements and pauses one.
    """
    paused = []
    if is_in(item.path, *NOT_TRACED):
        while (coverage := Coverage.current()) is not None:
            coverage.stop()
            paused.append(coverage)
    try:
        return (yield)
    finally:
        for coverage in reversed(paused):
            coverage.start()


@pytest.fixture
def address() -> str:
    """Return a loopback address whose port and the next one are free."""
    return free_address()


@pytest.fixture
def context() -> Iterator[Context]:
    kept = []

    class Keeping(zmq.Context[Socket]):
        """Nobody else may keep a test's sockets, and one that is forgotten warns."""

        def socket(self, *args: Any, **options: Any) -> Socket:
            kept.append(super().socket(*args, **options))
            return kept[-1]

    context = Keeping()
    yield context
    context.destroy(linger=0)


@pytest.fixture
def logged() -> Iterator[list[str]]:
    """The messages that our modules log during a test, from "info" on."""
    messages: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: messages.append(record.getMessage())
    for name in OUR_LOGGERS:
        logging.getLogger(name).addHandler(handler)
        logging.getLogger(name).setLevel(logging.INFO)
    yield messages
    for name in OUR_LOGGERS:
        logging.getLogger(name).removeHandler(handler)


@pytest.fixture(autouse=True)
def default_logging() -> Iterator[None]:
    """Undo what a command of the test has configured."""
    yield
    root = logging.getLogger()
    for handler in root.handlers[:]:
        if isinstance(handler, StderrHandler):
            root.removeHandler(handler)
    root.setLevel(logging.WARNING)
    for name in OUR_LOGGERS:
        logging.getLogger(name).setLevel(logging.NOTSET)


@pytest.fixture
def goes_first() -> Iterator[None]:
    """Give what the test starts a priority, where that may be had: other tests, which run beside
    it, must not look like a host that is too busy for the nodes."""
    if not hasattr(os, "setpriority"):
        yield
        return
    was = os.getpriority(os.PRIO_PROCESS, 0)
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, FIRST_NICENESS)
    yield
    os.setpriority(os.PRIO_PROCESS, 0, was)
