"""Sphinx configuration: `python -m sphinx -W --keep-going -n docs out/docs`."""

import sys
from importlib.metadata import version as installed_version
from pathlib import Path

from sphinx.application import Sphinx

_HERE = Path(__file__).parent
sys.path[:0] = [str(_HERE.parent), str(_HERE)]

project = "telepulse"
author = copyright = "The telepulse contributors"
version = release = installed_version("telepulse")

extensions = ["myst_parser", "sphinx.ext.autodoc", "ext.from_code"]
exclude_patterns = ["images", "firmware", "ext"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

nitpicky = True
# Types in signatures are text: not every one has a page, and no inventory is downloaded.
nitpick_ignore_regex = [("py:(class|obj)", ".*")]
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
default_role = "code"
smartquotes = False

html_theme = "furo"
html_title = "telepulse"
html_static_path: list[str] = []
html_show_sphinx = html_copy_source = False


def setup(app: Sphinx) -> None:
    """Leave out Python's own text on a named tuple's fields: the docstring has their meaning."""
    app.connect("autodoc-skip-member", _is_an_alias)


def _is_an_alias(
    _app: Sphinx, _what: str, _name: str, member: object, skip: bool, _options: object
) -> bool:
    return skip or str(member.__doc__).startswith("Alias for field number")
