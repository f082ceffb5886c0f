"""The drive of the live tests."""

from __future__ import annotations

from tests.live.conftest import drive

__all__ = ["drive"]
