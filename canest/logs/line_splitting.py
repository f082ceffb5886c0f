"""Text of a log to lines, as it is read: memory is bounded whatever the file holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from canest.logs.compression import Source

#: no row of a table is as long; of a longer line only the beginning is kept
LINE_CHARS_MAX = 1 << 20
_TEXT_BYTES = 1 << 18


def text_lines(source: Source, head: bytes, cut_off: Callable[[str], None]) -> Iterator[str]:
    """Yield the lines of a log without their ends; ``head``: what was read of it before.

    Of a line beyond `LINE_CHARS_MAX` a little more than that stands for the whole. cut_off: called with
    what a damaged archive holds of its last line, instead.
    """
    text, overlong = head, False
    while text:
        whole, newline, text = text.rpartition(b"\n")
        if newline:
            lines = _decoded(whole).split("\n")
            yield from lines[1:] if overlong else lines
            overlong = False
        if len(text) > LINE_CHARS_MAX and not overlong:
            yield _decoded(text)
            overlong = True
        if overlong:
            text = b""
        more = source.read(_TEXT_BYTES)
        if not more:
            break
        text += more
    if text and not overlong:
        if source.damage:
            cut_off(_decoded(text))
        else:
            yield _decoded(text)


def _decoded(text: bytes) -> str:
    return text.decode("utf-8", "replace").replace("\r", "")
