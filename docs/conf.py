"""Sphinx configuration: `python -m sphinx -W --keep-going -n docs out/docs`."""

import sys
from importlib.metadata import version as installed_version
from pathlib import Path

from sphinx.application import Sphinx

_HERE = Path(__file__).parent
sys.path.insert(0, str(_HERE.parent))

project = "telepulse"
author = copyright = "The telepulse contributors"
version = release = installed_version("telepulse")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["images", "ext"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

nitpicky = True
# Types in signatures are text: not every one has a page, and no inventory is downloaded.
nitpick_ignore_regex = [("py:(class|obj|exc)", ".*")]
napoleon_google_docstring = False
# Parameters that share a text stay one entry.
napoleon_use_param = False
# Attributes of a class are a list in its text, beside the members that autodoc finds.
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
default_role = "code"
smartquotes = False

# Each lesson is executed; one that fails fails the build.
sphinx_gallery_conf = {
    "examples_dirs": "../examples/lessons",
    "gallery_dirs": "lessons",
    "within_subsection_order": "FileNameSortKey",
    # Also where only the package changed.
    "run_stale_examples": True,
    "filename_pattern": r"\.py$",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,
    "copyfile_regex": "",
}

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
