"""The server of the built book: what it gives, and what it refuses."""

import socket
import subprocess
import sys
import threading
from http.client import HTTPConnection

import pytest
import serve


@pytest.fixture
def folder(tmp_path):
    """A page, a script, and links to a file inside and to files outside."""
    book = tmp_path / "book"
    (book / "chapters").mkdir(parents=True)
    (book / "index.html").write_text("the page")
    (book / "chapters" / "script.js").write_text("1")
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "key").write_text("the secret")
    (book / "inside").symlink_to(book / "index.html")
    (book / "outside").symlink_to(tmp_path / "secret" / "key")
    (book / "folder").symlink_to(tmp_path / "secret")
    (book / "loop").symlink_to(book / "loop")
    for name in ("index.html", "index.htm"):
        (book / name.partition(".")[2]).mkdir()
        (book / name.partition(".")[2] / name).symlink_to(tmp_path / "secret" / "key")
    return book


@pytest.fixture
def ask(folder):
    """The status and content that the server gives for a path."""
    with serve.make_server(folder) as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()

        def get(path: str, method: str = "GET") -> tuple[int, str]:
            connection = HTTPConnection("127.0.0.1", server.server_port)
            connection.putrequest(method, path, skip_host=False)  # the path is sent as it is
            connection.endheaders()
            answer = connection.getresponse()
            return answer.status, answer.read().decode()

        yield get
        server.shutdown()


def test_files_and_links_inside_the_folder_are_served(ask):
    assert ask("/") == ask("/index.html") == ask("/inside") == (200, "the page")
    assert ask("/chapters/script.js") == (200, "1")


OUTSIDE = ["/outside", "/folder/key", "/folder/", "/../secret/key", "/%2e%2e/secret/key"]
INDEXES = ["/html/", "/html/index.html", "/html", "/htm/", "/htm/index.htm"]  # links to a file outside
NO_PATHS = ["/none", "/loop", "/%00", "/html/%00", "/%ed%a0%80", "/" + 300 * "a"]


@pytest.mark.parametrize("path", OUTSIDE + INDEXES + NO_PATHS)
@pytest.mark.parametrize("method", ["GET", "HEAD"])
def test_nothing_outside_the_folder_is_served(ask, path, method):
    status, content = ask(path, method)
    assert status == 404 and "secret" not in content


@pytest.mark.parametrize("port", ["abc", "-1", "65536", "80.5", "", "1e3", "0x50"])
def test_an_impossible_port_is_refused_in_one_line(folder, port, capsys):
    with pytest.raises(SystemExit) as stop:
        serve.main([str(folder), "--", port])
    assert stop.value.code == f"error: port {port} is not a port number; give a number between 0 and 65535"


def test_a_port_in_use_and_a_missing_folder_are_refused(folder, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        arguments = [sys.executable, serve.__file__, str(folder), str(port)]
        result = subprocess.run(arguments, capture_output=True, text=True)
        assert result.returncode == 1 and result.stderr.count("\n") == 1
        assert result.stderr.startswith(f"error: port {port} cannot be used")
    with pytest.raises(ValueError, match="there is no folder .*nowhere"):
        serve.make_server(tmp_path / "nowhere")
