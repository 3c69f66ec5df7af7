"""Installed distributions of plug-ins, as files in a folder: no package is built."""

from pathlib import Path


def install(folder: Path, name: str, code: str, version: str = "1.2", **entry_points: str) -> None:
    """Write a distribution of one module, `name`, and what pip writes of its entry points.

    entry_points: of each group, with _ in place of its dot, lines "kind = class".
    """
    (folder / f"{name}.py").write_text(code, encoding="utf-8")
    info = folder / f"{name}-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n", encoding="utf-8"
    )
    lines: list[str] = []
    for group, pairs in entry_points.items():
        lines.append(f"[{group.replace('_', '.', 1)}]")
        lines += [pair.replace("= ", f"= {name}:") for pair in pairs.splitlines()]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
