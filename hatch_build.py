"""The part of data/ that a wheel carries: the smaller models, with a manifest of their own.

A file of data/ is in git once; the build takes it from there. A source distribution carries the same part as data/, so
that a wheel can be built from it. An editable installation finds data/ itself.
"""

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class SmallModels(BuildHookInterface):
    """Adds the models of the ``tasks`` and with the names ``files`` that the hook's settings list."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version == "editable":
            return
        data, target = Path(self.root) / "data", "data" if self.target_name == "sdist" else "detden_lite/data"
        sums = json.loads((data / "manifest.json").read_text("utf-8"))
        small = {name: digest for name, digest in sums.items() if self._is_small(Path(name))}
        self.temporary = TemporaryDirectory()
        manifest = Path(self.temporary.name) / "manifest.json"
        manifest.write_text(json.dumps(small, indent=1, sort_keys=True) + "\n", "utf-8")
        build_data["force_include"] |= {str(data / name): f"{target}/{name}" for name in small}
        build_data["force_include"][str(manifest)] = f"{target}/manifest.json"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        if version != "editable":
            self.temporary.cleanup()

    def _is_small(self, path: Path) -> bool:
        task = path.parts[0].split("-")[0]
        return len(path.parts) == 2 and task in self.config["tasks"] and path.stem in self.config["files"]
