"""One page with figures and tables: HTML in a folder, or Markdown with its figures in a folder beside it."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from PIL import Image

STYLE = """body{font:15px/1.5 system-ui,sans-serif;
max-width:1050px;margin:2em auto;
padding:0 1em;color:#222}
table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #ccc;padding:.25em .6em;text-align:right}
th:first-child,td:first-child{text-align:left}th{background:#f3f3f3}img{max-width:100%}
figure{margin:1.5em 0}figcaption{color:#555}
.why{background:#fff8e6;border-left:4px solid #e0b040;padding:.5em 1em}"""
_COLOURS = 48  # of a figure's palette: lines on a ground, a quarter of the size


class Page:
    """Collects sections; `write` puts the page beside the figures.

    output: NAME.md for Markdown (figures in the folder NAME), else a folder for index.html and the figures.
    """

    def __init__(self, output: Path, title: str) -> None:
        self.path = output if output.suffix == ".md" else output / "index.html"
        self.directory = output.with_suffix("") if output.suffix == ".md" else output
        self.directory.mkdir(parents=True, exist_ok=True)
        self._markdown = output.suffix == ".md"
        self._parts: list[str] = []
        self.section(title, level=1)

    def section(self, title: str, level: int = 2) -> None:
        self._add(f"<h{level}>{html.escape(title)}</h{level}>", f"{'#' * level} {title}")

    def text(self, text: str) -> None:
        self._add(f"<p>{html.escape(text)}</p>", _plain(text))

    def code(self, text: str) -> None:
        self._add(f"<pre>{html.escape(text)}</pre>", f"    {text}")

    def why(self, text: str) -> None:
        """Say why our numbers differ from the paper's."""
        self._add(f'<p class="why">{html.escape(text)}</p>', f"> **Why it differs.** {_plain(text)}")

    def table(self, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
        cells = [[_cell(c) for c in row] for row in rows]
        head = "".join(f"<th>{html.escape(h)}</th>" for h in header)
        body = "".join("<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>" for row in cells)
        lines = [header, ["---", *["---:"] * (len(header) - 1)], *cells]
        markdown = "\n".join(f"| {' | '.join(_plain(c) for c in line)} |" for line in lines)
        self._add(f"<table><tr>{head}</tr>{body}</table>", markdown)

    def figure(self, figure: Figure, name: str, caption: str) -> None:
        path = self.directory / f"{name}.png"
        figure.savefig(path, dpi=80, bbox_inches="tight")
        plt.close(figure)
        with Image.open(path) as drawn:
            drawn.convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
        text = html.escape(caption)
        self._add(
            f'<figure><img src="{name}.png" alt="{text}"><figcaption>{text}</figcaption></figure>',
            f"![{caption}]({self.directory.name}/{name}.png)\n\n*{_plain(caption)}*",
        )

    def write(self) -> Path:
        head = f'<!doctype html><meta charset="utf-8"><title>canest: papers</title><style>{STYLE}</style>'
        text = "\n\n".join(self._parts) + "\n" if self._markdown else head + "\n".join(self._parts)
        self.path.write_text(text, encoding="utf-8")
        return self.path

    def _add(self, as_html: str, as_markdown: str) -> None:
        self._parts.append(as_markdown if self._markdown else as_html)


def _plain(text: str) -> str:
    """Return the text with what Markdown would take as its own."""
    return text.replace("|", "\\|").replace("_", "\\_").replace("*", "\\*").replace("<", "&lt;")


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:,.3g}" if isinstance(value, float) and abs(value) < 1000 else (
        f"{value:,.0f}" if isinstance(value, float) else str(value)
    )  # fmt: skip


def axes(rows: int, width: float = 9.0, height: float = 2.4) -> tuple[Figure, Any]:
    """Return a figure with stacked axes that share time."""
    figure, found = plt.subplots(rows, 1, sharex=True, figsize=(width, height * rows), squeeze=False)
    for axis in found[:, 0]:
        axis.grid(alpha=0.3)
    return figure, found[:, 0]
