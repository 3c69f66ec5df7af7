"""Provenance: the origin of figures in summaries, recordings and reports.

It contains the scene in effect, the version, the host and the command. Of key files it has only the
paths on the command line. A scene may contain an address with a password, or a token among an
interface's options. Both are redacted, because results are passed on to others.
"""

import dataclasses
import json
import platform
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import BaseModel, TypeAdapter, ValidationError

from protocol.config.scene_file import load_document, read_chain
from protocol.errors import WireError

REDACTED = "(redacted)"
ABOUT = "--about"
_SECRET = (
    r"(?:password|passwd|passphrase|passwort|pwd|secret|token|credentials?|auth|authorization"
    r"|(?:api|access|private|secret|shared|licen[cs]e)[_-]?key)"
)
# A name that contains a word (or two) for a secret: "token", "cloud_token", "API-Key".
_SECRET_NAME = re.compile(rf"(?:.*[_\W])?{_SECRET}(?:[_\W].*)?", re.IGNORECASE | re.DOTALL)
# The part of an address before the @ and the host.
_USER = re.compile(r"(\b[a-z][a-z0-9+.-]*://)[^/\s?#]*@", re.IGNORECASE)
_NAMED_VALUE = re.compile(
    rf"((?:^|[\s?&;,{{-])(?:[\w-]*[_-])?{_SECRET}(?:[_-][\w-]*)?\s*=\s*)[^&;,\s]+", re.IGNORECASE
)


def redact(value: Any) -> Any:
    """Return a value of plain types without the secrets in it.

    A secret is a table's value under a secret's name; in a text, the user and password of an
    address, and the value of `name=value` with a secret's name.
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
    if isinstance(value, str):
        return _NAMED_VALUE.sub(rf"\1{REDACTED}", _USER.sub(rf"\1{REDACTED}@", value))
    return value


def redact_command(arguments: list[str]) -> list[str]:
    """Return a command line's arguments without the secrets in them.

    The value after an option with a secret's name is replaced as well, and what `--about` states of
    a person: telemetry has the command, and statements stay in the recording.
    """
    found: list[str] = []
    follows = False
    for argument in arguments:
        secret = follows and not argument.startswith("--")
        stated = argument.startswith(f"{ABOUT}=")
        plain = f"{ABOUT}={REDACTED}" if stated else redact(argument)
        found.append(REDACTED if secret else plain)
        secret_name = argument.startswith("--") and _SECRET_NAME.fullmatch(argument[2:])
        follows = argument == ABOUT or bool(secret_name)
    return found


# Topic of telemetry under which a display publishes its provenance.
PROVENANCE = b"provenance"
MAX_BYTES = 1 << 20
_ROOT = Path(__file__).parents[1]
_GIT_WITHIN_S = 2.0


@dataclass(frozen=True, slots=True)
class Provenance:
    """The origin of a run's results.

    commit: commit of the running checkout, with "-dirty" after changes; None outside a checkout.
    start_utc: start of the command, ISO 8601. command: the command line, redacted. scene: its path,
    the files that it extends, and their merged tables as written. effective: the sections in use,
    with all defaults. seeds: random seeds by their subject.
    """

    version: str
    commit: str | None
    start_utc: str
    host: str
    platform: str
    python: str
    command: list[str]
    scene: dict[str, Any] = field(default_factory=dict)
    effective: dict[str, Any] = field(default_factory=dict)
    seeds: dict[str, int] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON, without empty fields.

        The display's actuator and gains in effect are repeated under keys of their own.
        """
        table, display = dataclasses.asdict(self), self.effective.get("display", {})
        table |= {"actuator": display.get("actuator"), "gains": display.get("controller")}
        return {key: value for key, value in table.items() if value not in (None, {}, [])}

    def to_bytes(self) -> bytes:
        """Return the message that telemetry carries."""
        return json.dumps(self.to_dict()).encode()


def collect(
    scene: Path | None = None,
    sections: Mapping[str, BaseModel] | None = None,
    seeds: Mapping[str, int] | None = None,
) -> Provenance:
    """Collect the provenance of this process; call it once, before a loop.

    sections: validated sections of the scene, by name. Raises SceneError if its file cannot be
    read.
    """
    written: dict[str, Any] = {}
    if scene is not None:
        parents = [str(file) for file, _ in read_chain(scene)[1:]]
        written = {"path": str(scene), **({"extends": parents} if parents else {})}
        written["tables"] = load_document(scene)
    effective = {name: part.model_dump(mode="json") for name, part in (sections or {}).items()}
    seed = effective.get("sensing", {}).get("source", {}).get("seed")
    found = {"source": seed} if isinstance(seed, int) else {}
    program = Path(sys.argv[0])
    # `python -m telepulse` runs the package's `__main__.py`.
    name = program.parent.name if program.name == "__main__.py" else program.name
    return Provenance(
        version=version("telepulse"),
        commit=_commit(),
        start_utc=datetime.now(UTC).isoformat(timespec="milliseconds"),
        host=platform.node(),
        platform=platform.platform(),
        python=platform.python_version(),
        command=[name, *redact_command(sys.argv[1:])],
        scene=redact(written),
        effective=redact(effective),
        seeds=found | dict(seeds or {}),
    )


def read_provenance(data: bytes) -> dict[str, str]:
    """Return the fields of a telemetry message as text, tables as JSON. Raises WireError."""
    try:
        if len(data) > MAX_BYTES:
            raise ValueError("it is too long")
        table = _TABLE.validate_json(data)
    except (ValueError, ValidationError) as error:
        raise WireError("malformed", f"no provenance: {error!s:.80}") from None
    return {
        key: value if isinstance(value, str) else json.dumps(value) for key, value in table.items()
    }


_TABLE: TypeAdapter[dict[str, Any]] = TypeAdapter(dict[str, Any])


def _commit() -> str | None:
    """Return the commit of the running checkout; None outside a checkout or without git."""
    if not (_ROOT / ".git").exists():
        return None
    describe = ("describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    try:
        found = subprocess.run(
            ["git", "--no-optional-locks", "-C", str(_ROOT), *describe],
            capture_output=True,
            encoding="utf-8",
            timeout=_GIT_WITHIN_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return found.stdout.strip() or None
