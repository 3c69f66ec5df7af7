"""The public names and signatures, which users' programs depend on."""

import inspect
import re

import telepulse
from tests.support.nodes import ROOT

HELD = ROOT / "tests/golden/python_api.txt"


def parameters(function: object) -> str:
    """Return a function's parameters with their defaults; their types belong to mypy."""
    signature = inspect.signature(function)
    bare = [p.replace(annotation=inspect.Parameter.empty) for p in signature.parameters.values()]
    return str(inspect.Signature(bare))


def described(name: str) -> list[str]:
    """Return a name's parameters, and those of its public members."""
    value = getattr(telepulse, name)
    if not inspect.isclass(value) or issubclass(value, BaseException):
        return [name + (parameters(value) if inspect.isfunction(value) else "")]
    lines = [f"class {name}{parameters(value)}"]
    for key, member in sorted(vars(value).items()):
        if not key.startswith("_"):
            lines.append(f"    {key}{parameters(member) if inspect.isfunction(member) else ''}")
    return lines


def test_a_change_of_a_signature_is_deliberate() -> None:
    found = [line for name in telepulse.__all__ for line in described(name)]
    text = "\n".join(found) + "\n"
    assert text == HELD.read_text(encoding="utf-8"), (
        f"read in docs/reference/api.md what users are promised, then write {HELD}:\n{text}"
    )


def test_the_version_and_the_names_are_those_of_the_package() -> None:
    assert telepulse.__version__.count(".") == 2
    assert telepulse.__all__ == sorted(telepulse.__all__)
    reference = (ROOT / "docs/reference/api.md").read_text(encoding="utf-8")
    documented = [n for n in telepulse.__all__ if re.search(rf"telepulse\.{n}\b", reference)]
    assert documented == telepulse.__all__
    assert {name for name in dir(telepulse) if not name.startswith("__")} == {*telepulse.__all__}
    assert {"__version__", "__all__", "__doc__"} <= set(dir(telepulse))
