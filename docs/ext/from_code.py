"""The directive `from-code`: Markdown generated from the code when the pages are built.

    ```{from-code} scene_keys display_node.scene:DisplayScene display
    ```

The first word is a module of this package; its `write` receives the other words.
"""

import importlib
from typing import ClassVar

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


class FromCode(SphinxDirective):
    """A directive that is replaced by the output of `ext/NAME.py`."""

    required_arguments = 1
    optional_arguments = 9
    option_spec: ClassVar = {}

    def run(self) -> list[nodes.Node]:
        """Return the nodes of that Markdown, headings included."""
        name, *words = self.arguments
        text = importlib.import_module(f"ext.{name}").write(*words)
        return self.parse_text_to_nodes(text, allow_section_headings=True)


def load(target: str) -> object:
    """Return the object that `package.module:name` names."""
    module, _, name = target.partition(":")
    return getattr(importlib.import_module(module), name)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("from-code", FromCode)
    return {"parallel_read_safe": True}
