"""Fixtures of the decoder's tests."""

from __future__ import annotations

from collections.abc import Iterator
from unittest import mock

import pytest

from canest.decode import decoder


@pytest.fixture(params=["frame by frame", "in columns"])
def both_paths(request: pytest.FixtureRequest) -> Iterator[None]:
    """Run a test on each of the decoder's two paths."""
    with mock.patch.object(decoder, "SHORT_BLOCK", 10**9 if request.param == "frame by frame" else 0):
        yield
