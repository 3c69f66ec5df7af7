"""`telepulse scenes`: list, copy and show the scenes that come with telepulse, and list kinds."""

from pathlib import Path
from typing import Annotated

import tomlkit
import typer

from protocol.cli_options import one_line_errors, plain_console
from protocol.config.scene_file import find_scene, load_document, scene_names
from protocol.host.output import create_file
from telepulse.cli.options import PROGRAM, SceneArgument
from telepulse.plugins import GROUPS

app = typer.Typer(no_args_is_help=True, help="The scenes that come with telepulse.")


@app.command("list")
def list_scenes() -> None:
    """List each scene's name and title."""
    console, names = plain_console(), scene_names()
    width = max(map(len, names))
    with one_line_errors(PROGRAM):
        for name in names:
            console.print(f"{name:{width}}  {load_document(find_scene(name)).get('title', '')}")


@app.command()
def copy(
    scene: SceneArgument,
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="FILE.toml",
            help="Default: the scene's name, in this folder; nothing is overwritten.",
        ),
    ] = None,
) -> None:
    """Copy a scene's file for you to change."""
    with one_line_errors(PROGRAM):
        path = find_scene(scene)
        load_document(path)
        target = file or Path(path.name)
        create_file(target, path.read_text(encoding="utf-8"))
    plain_console().print(f"{target}: a copy of the scene {path.stem!r}, to be changed")


@app.command()
def show(scene: SceneArgument) -> None:
    """Print a scene with units, merged with the scenes that it extends."""
    with one_line_errors(PROGRAM):
        text = tomlkit.dumps(load_document(find_scene(scene)))
    plain_console().print(text, end="")


@app.command()
def kinds() -> None:
    """List the kinds of sources, sensors, drives, actuators and predictors that a scene may name.

    Each line names a group of entry points, a kind, and the distribution that it comes from, with
    its version and, where it cannot be used, the reason.

    Exit status: 0; 1 when a kind cannot be used.
    """
    console, listed = plain_console(), [each for group in GROUPS for each in group.listed()]
    group, kind = (max(len(getattr(each, key)) for each in listed) for key in ("group", "kind"))
    for each in listed:
        line = f"{each.group:{group}}  {each.kind:{kind}}  {each.distribution}"
        problem = "" if each.problem is None else f"  {each.problem}"
        console.print(f"{line} {each.version}{problem}", markup=False, soft_wrap=True)
    if any(each.problem for each in listed):
        raise SystemExit(1)
