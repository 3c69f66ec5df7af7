"""The variants, the most likely to differ first."""

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tests.machines.environments import (
    KEPT,
    Python,
    UnavailableError,
    dispatch_levels,
    environment,
    is_open,
    output,
    own,
    pythons,
)

NOBODY = "65534"
HOME = "/nonexistent"
# Kernels of OpenBLAS, with what a processor needs for them.
KERNELS = {"Prescott": "pni", "Haswell": "avx2", "Nehalem": "sse4_2", "SkylakeX": "avx512vl"}
GERMAN = "de_DE.UTF-8"


@dataclass(frozen=True)
class Variant:
    """What one run of the tests has different.

    what: said in the table. before: starts the command of the tests. checkout: its folder.
    missing: why it cannot run here.
    """

    name: str
    what: str
    python: Python = field(default_factory=own)
    versions: str = "pinned"
    settings: Mapping[str, str] = field(default_factory=dict)
    before: tuple[str, ...] = ()
    checkout: str = "telepulse"
    missing: str = ""


def _set(name: str, missing: str = "", **settings: str) -> Variant:
    what = " ".join(f"{key}={text}" for key, text in settings.items())
    return Variant(name, what, settings=settings, missing=missing)


def _processors() -> list[Variant]:
    """Return a variant for each level of numpy that can be switched off, the baseline first."""
    levels = dispatch_levels(environment(own()))
    return [
        _set(f"numpy-below-{level}", NPY_DISABLE_CPU_FEATURES=" ".join(levels[place:]))
        for place, level in enumerate(levels)
    ]


def _kernels() -> list[Variant]:
    cpuinfo = Path("/proc/cpuinfo")
    flags = cpuinfo.read_text(encoding="utf-8").split() if cpuinfo.exists() else []
    missing = {flag: "" if flag in flags else f"no {flag}" for flag in KERNELS.values()}
    return [
        _set(f"blas-{kernel}", missing[flag], OPENBLAS_CORETYPE=kernel)
        for kernel, flag in KERNELS.items()
    ]


def _german() -> Variant:
    """Return the variant of a language with decimal commas, made where it is not installed."""
    settings = {"LC_ALL": GERMAN}
    try:
        if "de_DE.utf8" not in output("locale", "-a").split():
            made = KEPT / "locales" / GERMAN
            made.parent.mkdir(parents=True, exist_ok=True)
            output("localedef", "--no-archive", "-i", "de_DE", "-f", "UTF-8", str(made))
            settings["LOCPATH"] = str(made.parent)
    except (UnavailableError, OSError) as error:
        return _set("german", str(error), LC_ALL=GERMAN)
    return _set("german", **settings)


def _ordinary_user(found: list[Python]) -> Variant:
    what = f"user {NOBODY}, HOME={HOME}"
    open_to_all = [each for each in (own(), *found) if is_open(Path(each.path))]
    if os.geteuid() != 0 or not shutil.which("setpriv"):
        return Variant("user", what, missing="needs root and setpriv")
    if not open_to_all or not is_open(KEPT):
        return Variant("user", what, missing="no Python, or no checkout, that is open to everybody")
    before = ("setpriv", "--reuid", NOBODY, "--regid", NOBODY, "--clear-groups")
    settings = {"HOME": HOME, "USER": "nobody", "LOGNAME": "nobody"}
    python = open_to_all[0]
    return Variant("user", f"{what}, Python {python}", python, settings=settings, before=before)


def _one_core() -> Variant:
    if not shutil.which("taskset"):
        return Variant("one-core", "one core", missing="there is no taskset")
    first = str(min(os.sched_getaffinity(0)))
    return Variant("one-core", "taskset: one core", before=("taskset", "-c", first))


def variants() -> list[Variant]:
    """Return every variant, with what is missing for those that cannot run here."""
    found, processors = pythons(), _processors()
    oldest, newest = found[0], found[-1]
    others = [each for each in (newest, *found[:-1]) if each.version != own().version]
    return [
        *(Variant(f"python-{each}", f"Python {each}", each) for each in others),
        *processors[:1],
        _ordinary_user(found),
        Variant("lowest", f"lowest versions, Python {oldest}", oldest, "lowest"),
        *_kernels(),
        _german(),
        Variant("path", 'in a folder "Prüf stand"', checkout="Prüf stand/telepulse"),
        _one_core(),
        _set("half-an-hour", TZ="Australia/Adelaide"),
        _set("c", LC_ALL="C"),
        *processors[1:],
        Variant("as-it-is", f"nothing, Python {own()}"),
        # Last: what others release may break it on any day.
        Variant("newest", f"newest versions, Python {newest}", newest, "newest"),
    ]
