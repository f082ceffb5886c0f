"""Text of a log cut at the ends of lines, as it is read: memory is bounded whatever the file holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Literal

from canest.logs.compression import Source

#: no row of a table is as long; of a longer line only the beginning is kept
LINE_CHARS_MAX = 1 << 20
_TEXT_BYTES = 1 << 18

#: lines: whole lines, the last ends before `end`. overlong: the beginning of a line beyond the limit, which
#: stands for the whole. last: the last line, without newline. cut off: what a damaged archive holds of it.
Kind = Literal["lines", "overlong", "last", "cut off"]
Part = tuple[Kind, bytes, int]  #: kind, text, end; behind `end` there may be more text


def text_parts(
    source: Source,
    head: bytes,
    longest: int,
    at_once: int,
    cleaned: Callable[[bytes], bytes] | None = None,
) -> Iterator[Part]:
    """Yield the text of a log, cut at the ends of lines.

    head: what was read of it before. longest: bytes of a line that is no longer kept as a whole.
    at_once: bytes that are read at a time. cleaned: what is made of text before it is cut.
    """
    text, overlong = head, False
    while True:
        if cleaned is not None and not overlong:
            text = cleaned(text)
        end = text.rfind(b"\n") + 1
        if overlong and end:  # the rest of a line whose beginning stood for the whole
            text, overlong = text[text.find(b"\n") + 1 :], False
            continue
        if end:
            yield "lines", text, end
            text = text[end:]
        if len(text) > longest and not overlong:
            yield "overlong", text, len(text)
            overlong = True
        if overlong:
            text = b""
        more = source.read(at_once)
        if not more:
            break
        text += more
    if text and not overlong:
        yield "cut off" if source.damage else "last", text, len(text)


def text_lines(source: Source, head: bytes, cut_off: Callable[[str], None]) -> Iterator[str]:
    """Yield the lines of a log without their ends; ``head``: what was read of it before.

    Of a line beyond `LINE_CHARS_MAX` a little more than that stands for the whole. cut_off: called with
    what a damaged archive holds of its last line, instead.
    """
    for kind, text, end in text_parts(source, head, LINE_CHARS_MAX, _TEXT_BYTES):
        if kind == "lines":
            yield from _decoded(text[: end - 1]).split("\n")
        elif kind == "cut off":
            cut_off(_decoded(text))
        else:
            yield _decoded(text)


def _decoded(text: bytes) -> str:
    return text.decode("utf-8", "replace").replace("\r", "")
