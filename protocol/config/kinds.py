"""Kinds of a scene's tables: telepulse's own, and those of plug-ins.

A table such as [sensing.source] says by its `kind` which section model reads it. The model is an
entry point in the table's group: `KindGroup.own` lists telepulse's, an installed distribution
declares others. The distributions are searched only for a kind that is not telepulse's own, and
only the plug-in that a scene names is imported.
"""

import inspect
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points, version
from typing import Any, Self, get_args

from pydantic import GetCoreSchemaHandler, ValidationError
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from protocol.config.quantities import shown
from protocol.config.scene import IN_KIND, Section
from protocol.errors import SceneError

OWN_DISTRIBUTION = "telepulse"


def load_object(path: str) -> Any:
    """Return an object by "module:name", for a table whose module must not import it.

    Raises SceneError with the reason, such as a library that is missing.
    """
    try:
        return EntryPoint("", path, "").load()
    except (Exception, SystemExit) as error:  # a plug-in may fail in any way
        raise SceneError(f"{path} cannot be loaded: {_reason(error)}") from None


def _reason(error: BaseException) -> str:
    """Return an error in one line, with its type where it is not ours."""
    name = "" if isinstance(error, SceneError) else f"{type(error).__name__}: "
    return " ".join(f"{name}{error}".split())


class KindTable(Section):
    """Base of the section models of kinds; that of one kind has a `kind: Literal["its name"]`."""

    kind: str

    @classmethod
    def narrow(cls, table: Section | None, where: str) -> Self:
        """Return a table that is of this kind. Raises SceneError, which begins with `where`."""
        if not isinstance(table, cls):
            wanted = get_args(cls.model_fields["kind"].annotation)[0]
            found = "" if table is None else f', not "{getattr(table, "kind", "another")}"'
            raise SceneError(f'{where} kind = "{wanted}" is needed here{found}')
        return table


@dataclass(frozen=True, slots=True)
class ListedKind:
    """One kind of a group; `problem` is the reason why it cannot be used, None without any."""

    group: str
    kind: str
    distribution: str
    version: str
    problem: str | None = None


@dataclass(frozen=True, eq=False)
class KindGroup:
    """The kinds that one table of a scene can have.

    name: the group of entry points, such as "telepulse.sources". noun: what a kind is. base: class
    of the group's section models. own: telepulse's kinds, as entry points: "module:class".
    """

    name: str
    noun: str
    base: type[KindTable]
    own: Mapping[str, str]

    def names(self) -> list[str]:
        """Return the names of all kinds, telepulse's own first."""
        found = sorted({entry.name for entry in entry_points(group=self.name)})
        return [*self.own, *(name for name in found if name not in self.own)]

    def listed(self) -> Iterator[ListedKind]:
        """Yield all kinds; each plug-in is imported."""
        for kind in self.own:
            yield ListedKind(self.name, kind, OWN_DISTRIBUTION, version(OWN_DISTRIBUTION))
        for entry in sorted(entry_points(group=self.name), key=lambda each: each.name):
            problem = None
            if entry.name in self.own:
                problem = "telepulse has a kind of this name, which is used"
            else:
                try:
                    find_kind(entry.name, [self])
                except SceneError as error:
                    problem = str(error)
            name, _, number = _distribution(entry).partition(" ")
            yield ListedKind(self.name, entry.name, name, number, problem)


def find_kind(kind: str, groups: Sequence[KindGroup]) -> type[Any] | None:
    """Return the section model of a kind of one of the groups; None where there is none.

    Raises SceneError for a plug-in that cannot be used, and for several of one name.
    """
    for group in groups:
        if kind in group.own:
            return _load_own(group, kind)
    found = [
        (group, each) for group in groups for each in entry_points(group=group.name, name=kind)
    ]
    if len(found) > 1:
        names = " and ".join(sorted(f"{_distribution(each)} ({each.group})" for _, each in found))
        raise SceneError(
            f'{groups[0].noun} kind "{kind}" comes from {names}, and only one of them can be meant:'
            " uninstall the other"
        )
    return _load(*found[0]) if found else None


def _load_own(group: KindGroup, kind: str) -> type[Any]:
    return _load(group, EntryPoint(kind, group.own[kind], group.name))


@cache
def _load(group: KindGroup, entry: EntryPoint) -> type[Any]:
    """Return the section model of an entry point. Raises SceneError."""
    try:
        found = entry.load()
        _refuse_misfit(group, entry, found)
    except (Exception, SystemExit) as error:  # a plug-in may fail in any way
        raise SceneError(
            f'{group.noun} kind "{entry.name}" of {_distribution(entry)} cannot be used:'
            f" {_reason(error)}"
        ) from None
    section: type[Any] = found
    return section


def _refuse_misfit(group: KindGroup, entry: EntryPoint, found: Any) -> None:
    """Raise SceneError where an object cannot be a kind of the group."""
    if not (isinstance(found, type) and issubclass(found, group.base)):
        raise SceneError(f"{entry.value} is no subclass of {group.base.__name__}")
    if inspect.isabstract(found):
        lacking = ", ".join(sorted(found.__abstractmethods__))
        own = version(OWN_DISTRIBUTION)
        raise SceneError(
            f"{entry.value} lacks {lacking}; it may be for another telepulse than {own}"
        )
    if entry.name not in get_args(found.model_fields["kind"].annotation):
        raise SceneError(f'{entry.value} lacks the field kind: Literal["{entry.name}"]')


def _distribution(entry: EntryPoint) -> str:
    """Return name and version of the distribution of an entry point."""
    dist = entry.dist
    return OWN_DISTRIBUTION if dist is None else f"{dist.metadata['Name']} {dist.version}"


class OfKind:
    """Annotation of a field whose value is a table of any kind of some groups.

    also: kinds that only this field can have. Errors of the kind's own model keep their keys.
    """

    def __init__(self, *groups: KindGroup, also: Mapping[str, type[Section]] = {}) -> None:
        self._groups, self._also = groups, also

    def sections(self) -> list[type[Section]]:
        """Return the section models of telepulse's own kinds, for the reference."""
        own = [_load_own(group, kind) for group in self._groups for kind in group.own]
        return [*own, *self._also.values()]

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return the schema of a field: its value is of a type that the value itself names."""
        return core_schema.no_info_plain_validator_function(self._validate)

    def _validate(self, value: object) -> Section:
        if isinstance(value, Section):
            return value
        if not isinstance(value, dict):
            raise PydanticCustomError("model_type", "must be a table")
        if "kind" not in value:
            raise SceneError("kind is missing; it must be given")
        section = self._find(value["kind"])
        try:
            return section.model_validate(value)
        except ValidationError as error:
            raise PydanticCustomError(IN_KIND, "is refused by its kind", {"error": error}) from None

    def _find(self, kind: object) -> type[Section]:
        """Return the section model of a kind. Raises SceneError where there is none."""
        if isinstance(kind, str):
            if kind in self._also:
                return self._also[kind]
            section: type[Section] | None = find_kind(kind, self._groups)
            if section is not None:
                return section
        known = [name for group in self._groups for name in group.names()] + list(self._also)
        listed = ", ".join(f"'{name}'" for name in known)
        names = " or ".join(group.name for group in self._groups)
        further = f"; plug-ins add kinds by entry points in {names}" if names else ""
        raise SceneError(f"unknown kind {shown(kind)}; known: {listed}{further}")
