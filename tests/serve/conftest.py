"""What the tests of the page share: a server that follows a stream of estimates, and a browser."""

from __future__ import annotations

import pytest

from tests.serve.browser import Browser
from tests.serve.rig import served


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture
def server(tmp_path, stream):
    """A page server for one test, that has received something."""
    with served(tmp_path, stream) as process:
        yield process
