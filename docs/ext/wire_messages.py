"""The fields of each message on the wire, with their types and ranges."""

from collections.abc import Iterator
from typing import Any

from pydantic import TypeAdapter

from protocol.wire import messages
from protocol.wire.description import StreamDescription


def write() -> str:
    """Return tables of the control messages and of the stream description in a welcome."""
    return "\n".join([*_control(), *_description()])


def _control() -> Iterator[str]:
    yield "## Control messages\n"
    yield "| message | fields after its name | what it says |\n|---|---|---|"
    for name, (kind, expected) in messages._KINDS.items():
        fields = zip(kind._fields, expected, strict=True)
        texts = (f"`{field}` {_taken(what)}" for field, what in fields)
        yield f"| `{name}` | {', '.join(texts)} | {_line(kind.__doc__)} |"
    yield ""


def _description() -> Iterator[str]:
    schema = TypeAdapter(StreamDescription).json_schema()
    parts = schema["$defs"]
    yield from _map("## Stream description", schema)
    for name, part in parts.items():
        yield from _map(f"### {name}", part)


def _map(heading: str, schema: dict[str, Any]) -> Iterator[str]:
    yield f"{heading}\n\n{_line(schema['description'])}\n"
    yield "| key | what it is | default |\n|---|---|---|"
    for key, rule in schema["properties"].items():
        default = f"`{rule['default']}`" if "default" in rule else "must be given"
        yield f"| `{key}` | {_allowed(rule)} | {default} |"
    yield ""


def _allowed(rule: dict[str, Any]) -> str:
    """Return a rule of JSON Schema in words."""
    if "$ref" in rule:
        return f"map, see {rule['$ref'].rpartition('/')[2]}"
    if "const" in rule or "enum" in rule:
        return " or ".join(f"`{value}`" for value in rule.get("enum", [rule.get("const")]))
    if rule["type"] == "array":
        kind = rule["items"]["$ref"].rpartition("/")[2]
        return f"{rule['minItems']} to {rule['maxItems']} maps, see {kind}"
    if rule["type"] == "string":
        return f"text of {rule['minLength']} to {rule['maxLength']} characters"
    if "minimum" in rule:
        return f"{rule['type']}, {rule['minimum']} to {rule['maximum']}"
    return str(rule["type"])


def _taken(what: type | range) -> str:
    if isinstance(what, range):
        return f"(integer, {_power(what.start)} ≤ n < {_power(what.stop)})"
    if what is str:
        return f"(text of at most {messages.MAX_NAME} characters)"
    return "(number or NaN)" if what is float else "(map)"


def _power(value: int) -> str:
    sign = "−" if value < 0 else ""
    return f"{sign}2^{abs(value).bit_length() - 1}" if value else "0"


def _line(text: str | None) -> str:
    return " ".join((text or "").split())
