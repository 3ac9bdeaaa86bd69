"""Serves a folder at localhost: ``python serve.py FOLDER [PORT]``; a busy port gives way to a free one."""

import argparse
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer


class _Quiet(SimpleHTTPRequestHandler):
    # Named here because some systems' tables lack or misname them, and a browser insists.
    extensions_map = SimpleHTTPRequestHandler.extensions_map | {".js": "text/javascript", ".wasm": "application/wasm"}

    def log_message(self, format: str, *args) -> None:
        pass


def make_server(folder: str, port: int = 0) -> ThreadingHTTPServer:
    """A server of ``folder`` on the loopback interface, not yet running; port 0 is any free one."""
    handler = partial(_Quiet, directory=str(folder))
    try:
        return ThreadingHTTPServer(("127.0.0.1", port), handler)
    except OSError:
        return ThreadingHTTPServer(("127.0.0.1", 0), handler)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder")
    parser.add_argument("port", type=int, nargs="?", default=8000)
    arguments = parser.parse_args()
    with make_server(arguments.folder, arguments.port) as server:
        print(f"The book is at http://localhost:{server.server_port}/ (Ctrl-C stops it)", flush=True)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            pass
