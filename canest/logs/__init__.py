"""Recorded logs in, results out: tolerant readers and streaming writers."""

from canest.core.table_block import TableBlock
from canest.logs.base import LogReader
from canest.logs.format_detection import open_log

__all__ = ["LogReader", "TableBlock", "open_log"]
