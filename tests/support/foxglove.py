"""Requirements of Foxglove on a JSON schema and on the messages that follow it.

They are those of its schema reader: a type is one word, objects name their properties, the items of
an array are no arrays, and a choice is between numbers.
"""

from base64 import b64decode
from typing import Any

PLAIN = {
    "boolean": (bool,),
    "string": (str,),
    "number": (int, float),
    "integer": (int,),
}


def assert_readable(schema: dict[str, Any], where: str) -> None:
    """Check that Foxglove can read an object's schema."""
    assert schema["type"] == "object", where
    for name, field in schema["properties"].items():
        place = f"{where}.{name}"
        if "oneOf" in field:
            assert all(type(choice["const"]) is int for choice in field["oneOf"]), place
            continue
        assert field.get("contentEncoding", "base64") == "base64", place
        item = field["items"] if field["type"] == "array" else field
        if item["type"] == "object":
            assert_readable(item, place)
        else:
            assert item["type"] in PLAIN, place


def assert_fits(value: Any, schema: dict[str, Any], where: str) -> None:
    """Check a value against its schema. Counts under free names are numbers."""
    if "oneOf" in schema:
        assert value in [choice["const"] for choice in schema["oneOf"]], where
    elif schema["type"] == "array":
        assert type(value) is list, where
        for item in value:
            assert_fits(item, schema["items"], where)
    elif schema["type"] == "object":
        for name, inner in value.items():
            if schema["properties"]:
                assert_fits(inner, schema["properties"][name], f"{where}.{name}")
            else:
                assert type(inner) is int, where
    else:
        assert type(value) in PLAIN[schema["type"]], f"{where}: {value!r}"
        if "contentEncoding" in schema:
            b64decode(value, validate=True)
