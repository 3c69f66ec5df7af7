"""Markdown pages with parts that are generated from the code.

A part is between two comments. The first names a module of this package, and the words that its
`write` receives:

    <!-- from code: scene_keys display_node.scene:DisplayScene display -->
    <!-- end -->
"""

import importlib
import re
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "reference"
_PART = re.compile(r"(<!-- from code: ([^>]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def generated(text: str) -> str:
    """Return a page's text with its parts generated again."""
    return _PART.sub(_part, text)


def _part(found: re.Match[str]) -> str:
    name, *words = found[2].split()
    written = importlib.import_module(f"{__package__}.{name}").write(*words)
    return f"{found[1]}\n{written.strip()}\n\n{found[3]}"


def load(target: str) -> object:
    """Return the object that `package.module:name` names."""
    module, _, name = target.partition(":")
    return getattr(importlib.import_module(module), name)
