"""One HTML page with figures (PNG beside it) and tables."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

STYLE = """body{font:15px/1.5 system-ui,sans-serif;
max-width:1050px;margin:2em auto;
padding:0 1em;color:#222}
table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #ccc;padding:.25em .6em;text-align:right}
th:first-child,td:first-child{text-align:left}th{background:#f3f3f3}img{max-width:100%}
figure{margin:1.5em 0}figcaption{color:#555}
.why{background:#fff8e6;border-left:4px solid #e0b040;padding:.5em 1em}"""


class Page:
    """Collects sections; `write` puts index.html beside the figures."""

    def __init__(self, directory: Path, title: str) -> None:
        self.directory = directory
        directory.mkdir(parents=True, exist_ok=True)
        self._parts = [f"<h1>{html.escape(title)}</h1>"]

    def section(self, title: str, level: int = 2) -> None:
        self._parts.append(f"<h{level}>{html.escape(title)}</h{level}>")

    def text(self, text: str) -> None:
        self._parts.append(f"<p>{html.escape(text)}</p>")

    def why(self, text: str) -> None:
        """Say why our numbers differ from the paper's."""
        self._parts.append(f'<p class="why">{html.escape(text)}</p>')

    def table(self, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
        head = "".join(f"<th>{html.escape(h)}</th>" for h in header)
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(_cell(c))}</td>" for c in row) + "</tr>" for row in rows
        )
        self._parts.append(f"<table><tr>{head}</tr>{body}</table>")

    def figure(self, figure: Figure, name: str, caption: str) -> None:
        figure.savefig(self.directory / f"{name}.png", dpi=110, bbox_inches="tight")
        plt.close(figure)
        text = html.escape(caption)
        self._parts.append(
            f'<figure><img src="{name}.png" alt="{text}"><figcaption>{text}</figcaption></figure>'
        )

    def write(self) -> Path:
        path = self.directory / "index.html"
        head = f'<!doctype html><meta charset="utf-8"><title>canest: papers</title><style>{STYLE}</style>'
        path.write_text(head + "\n".join(self._parts), encoding="utf-8")
        return path


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
