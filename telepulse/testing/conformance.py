"""Common parts of the conformance tests of all kinds."""

import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar, get_args

from protocol.config.kinds import KindTable, find_kind
from protocol.config.scene import Section, validate
from protocol.errors import SceneError
from telepulse.plugins import GROUPS

Result = TypeVar("Result")
TableT = TypeVar("TableT", bound=KindTable)
# A thread that was told to end may take this long on a busy machine.
ENDS_WITHIN_S = 2.0


class ConformanceError(AssertionError):
    """A plug-in does not keep to the interface of its kind."""


def require(holds: object, message: str) -> None:
    """Raise ConformanceError with a message where something does not hold."""
    if not holds:
        raise ConformanceError(message)


def call_within(seconds: float, what: str, call: Callable[[], Result]) -> Result:
    """Return a call's result. Raises ConformanceError where it takes longer than `seconds`."""
    found: list[Result] = []
    raised: list[BaseException] = []

    def run() -> None:
        try:
            found.append(call())
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(seconds)
    require(not thread.is_alive(), f"{what} did not return within {seconds:g} s: it waits")
    if raised:
        raise raised[0]
    return found[0]


@contextmanager
def check_release(what: str) -> Iterator[None]:
    """Check that threads and file descriptors that were opened within the `with` are released."""
    threads, files = set(threading.enumerate()), _descriptors()
    yield
    deadline_s = time.monotonic() + ENDS_WITHIN_S
    while left := {each for each in set(threading.enumerate()) - threads if each.is_alive()}:
        names = ", ".join(sorted(each.name for each in left))
        require(time.monotonic() < deadline_s, f"{what} leaves a thread that runs on: {names}")
        time.sleep(0.01)
    opened = len(_descriptors() - files)
    require(opened == 0, f"{what} leaves {opened} open files")


def read_table(section: type[TableT], keys: Mapping[str, Any]) -> TableT:
    """Return a kind's table for its keys in a scene, after checks of the section model."""
    kind = keys.get("kind")
    require(kind is not None, 'give the kind among the keys: {"kind": …}')
    declared = get_args(section.model_fields["kind"].annotation)
    require(kind in declared, f'{section.__name__} lacks the field kind: Literal["{kind}"]')
    table = validate(dict(keys), section, f"{section.__name__}:")
    require(
        section.model_config.get("frozen"), f"{section.__name__} is not frozen: keep the config"
    )
    return table


def check_entry_point(section: type[Section]) -> None:
    """Check that an installed distribution provides a section model as a kind of its group."""
    group = next((each for each in GROUPS if issubclass(section, each.base)), None)
    if group is None:
        bases = ", ".join(each.base.__name__ for each in GROUPS)
        raise ConformanceError(f"{section.__name__} is a subclass of none of {bases}")
    for kind in get_args(section.model_fields["kind"].annotation):
        try:
            found = find_kind(kind, [group])
        except SceneError as error:
            raise ConformanceError(str(error)) from None
        require(
            found is section,
            f"no installed distribution has {section.__module__}:{section.__name__} as the entry"
            f' point "{kind}" in {group.name}',
        )


def _descriptors() -> set[str]:
    """Return the process's open files; none where the system does not list them."""
    return set(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else set()
