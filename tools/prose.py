"""Measures the prose of Markdown pages: mean and longest sentence, and table cells of several sentences.

``python tools/prose.py [PAGE ...]`` prints one line per page and exits with 1 if a sentence is too long;
without a page it reads README.md, the other pages of the top folder and docs/ (not docs/measured, which
benchmarks write). Code blocks and formulas on lines of their own do not count; a list item or a table
cell ends a sentence; inline code is one word. The mean is that of paragraphs and lists: cells are short
by nature.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LONGEST_WORDS = 40

_FENCE = re.compile(r"^ *(```|~~~)")
_ITEM = re.compile(r"^ *(?:[-*+]|\d+\.) +")
_CELL_BORDER = re.compile(r"(?<!\\)\|")
_RULE = re.compile(r"^[|:\- ]+$")
_CODE = re.compile(r"`[^`]*`")
_FORMULA = re.compile(r"\$[^$]+\$")
_LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
#: abbreviations whose full stop ends no sentence
_ABBREVIATION = re.compile(r"\b(e\.g|i\.e|al|eq|eqs|Alg|vs|approx|No)\.(?= )")
_END = re.compile(r"(?<=[.!?])[\"')*_]*\s+(?=[\"'(*_]*[A-Z0-9])")
_WORD = re.compile(r"\w[\w'’.,:/%-]*")


@dataclass
class Prose:
    """Sentences of paragraphs and lists, sentences of table cells, and cells with more than one of them."""

    running: list[str] = field(default_factory=list)
    in_cells: list[str] = field(default_factory=list)
    crowded_cells: list[str] = field(default_factory=list)

    @property
    def mean_words(self) -> float:
        """Words per sentence of paragraphs and lists (0 when there are none)."""
        return sum(map(words, self.running)) / len(self.running) if self.running else 0.0

    @property
    def longest(self) -> str:
        """The longest sentence, cells included ('' when there is none)."""
        return max([*self.running, *self.in_cells], key=words, default="")

    def too_long(self, limit: int = LONGEST_WORDS) -> list[str]:
        """Return the sentences of more than ``limit`` words."""
        return [s for s in [*self.running, *self.in_cells] if words(s) > limit]


def words(sentence: str) -> int:
    """Return how many words a sentence has; inline code is one."""
    return len(_WORD.findall(sentence))


def sentences(text: str) -> list[str]:
    """Return the sentences of one paragraph, list item or cell."""
    plain = _LINK.sub(r"\1", _FORMULA.sub("FORMULA", _CODE.sub("CODE", text)))
    plain = _ABBREVIATION.sub(r"\1", " ".join(plain.split()))
    return [part for part in _END.split(plain) if words(part)]


def measured(markdown: str) -> Prose:
    """Return the prose of a page."""
    prose = Prose()
    for kind, text in _parts(_COMMENT.sub("", markdown)):
        if kind == "text":
            prose.running += sentences(text)
            continue
        found = sentences(text)
        prose.in_cells += found
        if len(found) > 1:
            prose.crowded_cells.append(text)
    return prose


def _parts(markdown: str) -> Iterator[tuple[str, str]]:
    """Yield ("text", a paragraph or list item) and ("cell", one table cell)."""
    paragraph: list[str] = []
    in_fence = in_formula = in_list = False
    for line in [*markdown.split("\n"), ""]:
        stripped = line.strip()
        is_item = _ITEM.match(line) is not None
        was_blank = not paragraph
        if not in_formula and _FENCE.match(line):
            in_fence = not in_fence
        skipped = in_fence or in_formula or _FENCE.match(line) is not None
        if not in_fence and stripped.startswith("$$"):
            in_formula = not in_formula and not (len(stripped) > 2 and stripped.endswith("$$"))
            skipped = True
        if not skipped and was_blank and not is_item and line.startswith("    "):
            skipped = not in_list or line.startswith("       ")  # indented code
        ends = skipped or is_item or not stripped or stripped.startswith(("#", "|"))
        if ends and paragraph:
            yield "text", " ".join(paragraph)
            paragraph = []
        if skipped or not stripped or stripped.startswith("#"):
            continue
        in_list = is_item or (in_list and line.startswith(" "))
        if stripped.startswith("|"):
            if not _RULE.match(stripped):
                yield from (("cell", cell) for cell in _CELL_BORDER.split(stripped)[1:-1])
            continue
        paragraph.append(_ITEM.sub("", line).strip())


def pages() -> list[Path]:
    """Return the pages that people write: no measured figures, no help of commands."""
    return [
        *sorted(ROOT.glob("*.md")),
        *(
            p
            for p in sorted((ROOT / "docs").rglob("*.md"))
            if p.parent.name != "measured" and p.name != "commands.md"
        ),
    ]


def main(arguments: list[str]) -> int:
    """Print one line per page and every sentence that is too long; return the exit status."""
    status = 0
    print(f"{'page':40} {'sentences':>9} {'mean':>5} {'longest':>7} {'crowded cells':>13}")
    for page in [Path(a).resolve() for a in arguments] or pages():
        prose = measured(page.read_text(encoding="utf-8"))
        name = str(page.relative_to(ROOT) if page.is_relative_to(ROOT) else page)
        print(
            f"{name:40} {len(prose.running):9} {prose.mean_words:5.1f} {words(prose.longest):7} "
            f"{len(prose.crowded_cells):13}"
        )
        for sentence in prose.too_long():
            status = 1
            print(f"  {words(sentence)} words, at most {LONGEST_WORDS}: {sentence}")
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
