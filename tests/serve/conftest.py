"""What the tests of the page share: a stream of estimates, a server that follows it, a browser."""

from __future__ import annotations

import pytest

from tests.serve.browser import Browser
from tests.serve.rig import Stream, served


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture
def stream(tmp_path):
    stream = Stream(tmp_path)
    yield stream
    stream.close()


@pytest.fixture
def server(tmp_path, stream):
    """A page server for one test, that has received something."""
    with served(tmp_path, stream) as process:
        yield process
