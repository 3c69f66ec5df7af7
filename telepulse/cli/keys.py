"""`telepulse keys`: make keys, and list the nodes that may connect."""

from pathlib import Path
from typing import Annotated

import typer

from protocol.cli_options import one_line_errors, plain_console
from protocol.security.allow_list import FILE_NAME, allow, default_path, read_allow_list, revoke
from protocol.security.keys import new_pair, read_public
from telepulse.cli.options import PROGRAM

app = typer.Typer(
    no_args_is_help=True,
    help="Keys by which nodes on two machines identify each other. Each node has one: its secret"
    " key never leaves its machine; its public key goes to the machine it connects to.",
)

NameArgument = Annotated[
    str, typer.Argument(metavar="NAME", help="Name of the node, such as wrist or finger.")
]
FolderOption = Annotated[Path, typer.Option(help="Folder of the keys.")]
ListOption = Annotated[
    Path | None,
    typer.Option(
        "--list",
        metavar="FILE",
        help=f"Path of the allow-list; default: '{FILE_NAME}' in the folder.",
    ),
]
FOLDER = Path("keys")


@app.command()
def new(name: NameArgument, folder: FolderOption = FOLDER) -> None:
    """Make a key pair: NAME.key, which only you may read, and NAME.pub, for other machines."""
    with one_line_errors(PROGRAM):
        secret_path, public_path = new_pair(folder, name)
    plain_console().print(
        f"{secret_path}: secret, stays on this machine: --key {secret_path}\n"
        f"{public_path}: public, one line; copy it to the other machine. There\n"
        f"  a sensing node allows {name} by: telepulse keys allow {public_path.name}\n"
        f"  a display connects to {name} with: --peer {public_path.name}"
    )


@app.command(name="allow")
def allow_command(
    public_path: Annotated[
        Path, typer.Argument(metavar="FILE.pub", help="The node that may connect.")
    ],
    folder: FolderOption = FOLDER,
    allow_list: ListOption = None,
) -> None:
    """Allow a node: add its public key to the allow-list; running nodes follow within 1 s."""
    path = allow_list or default_path(folder)
    with one_line_errors(PROGRAM):
        peer = read_public(public_path)
        allow(path, peer)
    plain_console().print(f"{path} allows {peer.name}")


@app.command(name="revoke")
def revoke_command(
    name: NameArgument, folder: FolderOption = FOLDER, allow_list: ListOption = None
) -> None:
    """Revoke a node's permission; running nodes cut its connections within 2 s."""
    path = allow_list or default_path(folder)
    with one_line_errors(PROGRAM):
        revoke(path, name)
    plain_console().print(f"{path} no longer allows {name}")


@app.command(name="list")
def list_command(folder: FolderOption = FOLDER, allow_list: ListOption = None) -> None:
    """Print the name and public key of each node that may connect."""
    path = allow_list or default_path(folder)
    with one_line_errors(PROGRAM):
        lines = [f"{peer.key.hex()}  {peer.name}" for peer in read_allow_list(path).values()]
    plain_console().print("\n".join(lines or [f"{path} allows nobody"]))
