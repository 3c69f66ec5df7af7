"""Removal of secrets from what results carry: passwords in addresses, and options that name one.

A scene may name an adapter by an address with a password, or give its interface a token among its
options. Results are passed on to people who are to have neither.
"""

import re
from collections.abc import Mapping
from typing import Any

REDACTED = "(redacted)"
_SECRET = (
    r"(?:password|passwd|passphrase|passwort|pwd|secret|token|credentials?|auth|authorization"
    r"|(?:api|access|private|secret|shared|licen[cs]e)[_-]?key)"
)
# A name of which one word, or two, are secret: "token", "cloud_token", "API-Key".
_SECRET_NAME = re.compile(rf"(?:.*[_\W])?{_SECRET}(?:[_\W].*)?", re.IGNORECASE | re.DOTALL)
# Whatever stands before the @ of an address's host.
_USER = re.compile(r"(\b[a-z][a-z0-9+.-]*://)[^/\s?#]*@", re.IGNORECASE)
_NAMED_VALUE = re.compile(
    rf"((?:^|[\s?&;,{{-])(?:[\w-]*[_-])?{_SECRET}(?:[_-][\w-]*)?\s*=\s*)[^&;,\s]+", re.IGNORECASE
)


def redact(value: Any) -> Any:
    """Return a value of plain types without the secrets in it.

    Parameters
    ----------
    value
        Text, a number, or tables and lists of such. Of a table's entries with a secret's name the
        value is replaced; in text, the user and password of an address, and `name=value` with a
        secret's name.
    """
    if isinstance(value, Mapping):
        return {
            key: REDACTED
            if _SECRET_NAME.fullmatch(str(key)) and not isinstance(entry, Mapping)
            else redact(entry)
            for key, entry in value.items()
        }
    if isinstance(value, list | tuple):
        return [redact(entry) for entry in value]
    return redact_text(value) if isinstance(value, str) else value


def redact_text(text: str) -> str:
    """Return a text without the users and passwords of addresses, and without named secrets."""
    text = _USER.sub(rf"\1{REDACTED}@", text)
    return _NAMED_VALUE.sub(rf"\1{REDACTED}", text)


def redact_command(arguments: list[str]) -> list[str]:
    """Return a command line's arguments without the secrets in them.

    Of an option with a secret's name, the value after it is replaced as well.
    """
    found: list[str] = []
    follows = False
    for argument in arguments:
        secret = follows and not argument.startswith("--")
        found.append(REDACTED if secret else redact_text(argument))
        follows = argument.startswith("--") and bool(_SECRET_NAME.fullmatch(argument[2:]))
    return found
