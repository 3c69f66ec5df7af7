"""Build hook of hatchling: compiled modules in the wheel where TELEPULSE_COMPILED=1."""

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

# mypy reads the types of the libraries that the modules use.
REQUIRES = ["mypy>=1.13", "setuptools>=70", "numpy>=1.26", "msgpack>=1.0.8", "pydantic>=2.11"]
REQUIRES += ["pyzmq>=26", "scipy-stubs>=1.14"]


def wanted() -> bool:
    """Return whether compiled modules were requested."""
    return os.environ.get("TELEPULSE_COMPILED", "") not in ("", "0")


class CompiledBuildHook(BuildHookInterface):  # type: ignore[type-arg]
    """Hook that compiles modules into a wheel, beside their sources."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """Return what a compiled build requires besides hatchling."""
        return REQUIRES if wanted() else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the modules and add them to the wheel."""
        if not wanted() or self.target_name != "wheel":
            return
        if version == "editable":
            # In a checkout, a compiled module would hide later changes of its source.
            self.app.abort("compiled modules are not installed editable: make install COMPILED=1")
        # `finalize` removes it, once the wheel has been written.
        self._compiled = TemporaryDirectory()
        root, folder = Path(self.root), Path(self._compiled.name)
        command = [sys.executable, str(root / "compile_core.py"), str(folder)]
        if (status := subprocess.run(command, check=False).returncode) != 0:
            sys.exit(status)
        build_data["pure_python"], build_data["infer_tag"] = False, True
        for path in folder.rglob("*.*"):
            build_data["force_include"][str(path)] = str(path.relative_to(folder))

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the compiled modules, which the wheel contains now."""
        if wanted() and self.target_name == "wheel":
            self._compiled.cleanup()
