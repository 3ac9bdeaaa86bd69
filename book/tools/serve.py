"""Serves a folder at localhost: ``python serve.py FOLDER [PORT]``."""

import argparse
import sys
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from io import BytesIO
from pathlib import Path
from typing import BinaryIO


class _Handler(SimpleHTTPRequestHandler):
    # Named here because some systems' tables lack or misname them, and a browser insists.
    extensions_map = SimpleHTTPRequestHandler.extensions_map | {".js": "text/javascript", ".wasm": "application/wasm"}

    def log_message(self, format: str, *args: object) -> None:
        pass

    def send_head(self) -> BytesIO | BinaryIO | None:
        """Answer as the base class does, unless a link leads out of the folder."""
        if self._is_inside():
            return super().send_head()
        self.send_error(HTTPStatus.NOT_FOUND, "File not found")
        return None

    def _is_inside(self) -> bool:
        """Whether the path, and the page that stands for it if it is a folder, lead to places inside the folder."""
        path, root = Path(self.translate_path(self.path)), Path(self.directory).resolve()
        try:
            return all((path / name).resolve().is_relative_to(root) for name in ("", "index.html", "index.htm"))
        except (OSError, RuntimeError, ValueError):  # a loop of links, or no path at all, such as one with a null byte
            return False


class _Server(ThreadingHTTPServer):
    allow_reuse_address = sys.platform != "win32"  # where it would let two servers share a port


def make_server(folder: str | Path, port: int = 0) -> ThreadingHTTPServer:
    """A server of a folder on the loopback interface, not yet running.

    Args:
        folder: what is served. Symbolic links that lead out of it are not followed.
        port: 0 takes any free one.

    Raises:
        ValueError: if there is no such folder, or the port is not between 0 and 65535 or is in use.
    """
    if not Path(folder).is_dir():
        raise ValueError(f"there is no folder {folder}")
    if not 0 <= port <= 65535:
        raise ValueError(f"port {port} is not a port number; give a number between 0 and 65535")
    try:
        return _Server(("127.0.0.1", port), partial(_Handler, directory=str(folder)))
    except OSError as error:
        raise ValueError(f"port {port} cannot be used ({error.strerror}); give another one, or 0 for any") from None


def main(argv: list[str] | None = None) -> None:
    """Serve until Ctrl-C. An argument that is refused is one line on stderr and the exit status 1."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder")
    parser.add_argument("port", nargs="?", default="8000", help="default: %(default)s; 0 takes any free one")
    arguments = parser.parse_args(argv)
    try:
        if not arguments.port.isdecimal():
            raise ValueError(f"port {arguments.port} is not a port number; give a number between 0 and 65535")
        server = make_server(arguments.folder, int(arguments.port))
    except ValueError as error:
        sys.exit(f"error: {error}")
    with server:
        print(f"The book is at http://localhost:{server.server_port}/ (Ctrl-C stops it)", flush=True)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            pass


if __name__ == "__main__":
    main()
