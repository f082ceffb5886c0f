"""A link with the token, as somebody sends it around, followed in a real browser."""

from __future__ import annotations

import http.server
import threading

import pytest

from tests.serve.browser import BROWSER, Browser
from tests.serve.rig import Command, Stream, free_port, is_up, wait_for

pytestmark = [pytest.mark.slow, pytest.mark.skipif(BROWSER is None, reason="no Chromium here")]

TOKEN = "0123456789abcdef"
ELSEWHERE = "--host-resolver-rules=MAP mail.example 127.0.0.1"
HAS_PAGE = "document.title.includes('canest live')"


@pytest.fixture
def link(tmp_path):
    """The link of a page that needs a token."""
    stream, port = Stream(tmp_path), free_port()
    (tmp_path / "token").write_text(f"{TOKEN}\n")
    options = ["--socket", stream.status_socket, "--port", port, "--token-file", tmp_path / "token"]
    with Command(tmp_path, "serve", *options) as server:
        assert wait_for(lambda: is_up(port), 20), server.output
        yield f"http://127.0.0.1:{port}/?token={TOKEN}"
    stream.close()


@pytest.fixture
def mail(link):
    """The port of another site, which has the link on a page."""

    class Mail(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(f"<a href='{link}'>truck</a>".encode())

        def log_message(self, *_):
            pass

    server = http.server.HTTPServer(("127.0.0.1", 0), Mail)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server.server_port
    server.shutdown()
    server.server_close()


def test_a_link_on_the_page_of_another_site_leads_to_the_page_and_is_kept(tmp_path, mail, link):
    with Browser(tmp_path / "profile", ELSEWHERE) as browser:
        tab = browser.page(f"http://mail.example:{mail}/")
        tab.wait("document.links.length === 1")
        tab.click("document.links[0]")
        tab.wait(HAS_PAGE)
        assert tab.run("location.search") == ""
        [cookie] = tab.call("Network.getCookies")["cookies"]
        assert not cookie["session"] and cookie["httpOnly"]
        again = link.partition("?")[0]
        tab.open(again)
        tab.wait(f"location.href === '{again}' && {HAS_PAGE}")
