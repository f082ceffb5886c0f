"""Builds the documentation site from the Markdown pages: ``python tools/build_site.py [-o build/site]``.

The pages stay as they are read on GitHub. This program copies them into a folder of their own, where

- docs/README.md is the front page, and its sections with their links are the menus;
- the Markdown pages of the top folder are pages below ``project/``;
- a link to any other file of the repository leads to a copy of that file.

Sphinx then builds it, and every warning is an error. The site needs no network: search, fonts and scripts
are files beside the pages. It needs the extra ``docs``.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
FRONT = DOCS / "README.md"
SETTINGS = ROOT / "tools" / "site"
#: pages of the top folder -> where they are in the site
TOP_PAGES = {
    "README.md": "project/readme.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "SECURITY.md": "project/security.md",
    "NOTICES.md": "project/notices.md",
    "CHANGELOG.md": "project/changelog.md",
}
IMAGES = {".svg", ".png"}

_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s#]*)(#[^)\s]*)?\)")
_FENCED = re.compile(r"(^ *```.*?^ *```[^\n]*$)", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Section:
    """A menu: its title, its text, and its pages as paths in the site without ``.md``."""

    title: str
    text: str
    pages: tuple[str, ...]

    @property
    def name(self) -> str:
        """The section's page, ``sections/measured-results``."""
        return "sections/" + re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")


def place(path: Path) -> str | None:
    """Return where a page of the repository is in the site, or None if it is no page of it."""
    if path == FRONT:
        return "index.md"
    name = path.relative_to(ROOT).as_posix()
    if name in TOP_PAGES:
        return TOP_PAGES[name]
    if path.suffix in {".md", *IMAGES} and path.is_relative_to(DOCS):
        return path.relative_to(DOCS).as_posix()
    return None


def sections() -> list[Section]:
    """Return the menus: the sections of docs/README.md that have links to pages."""
    found = []
    for part in re.split(r"^## ", FRONT.read_text(encoding="utf-8"), flags=re.M)[1:]:
        title, _, text = part.partition("\n")
        pages = []
        for _, _, target, _ in _LINK.findall(text):
            at = place((DOCS / target).resolve()) if target.endswith(".md") else None
            if at and at.removesuffix(".md") not in pages:
                pages.append(at.removesuffix(".md"))
        if pages:
            found.append(Section(title.strip(), text.strip(), tuple(pages)))
    return found


class Assembly:
    """The folder that Sphinx reads: pages whose links hold there, and copies of the files they lead to."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def everything(self) -> None:
        """Write the front page, the menus, all pages and their images, and the settings."""
        menus = sections()
        for menu in menus:
            text = f"# {menu.title}\n\n{menu.text}\n\n{_toctree(['/' + page for page in menu.pages])}"
            self.page(FRONT, f"{menu.name}.md", text)
        front = FRONT.read_text(encoding="utf-8")
        self.page(FRONT, "index.md", f"{front}\n{_toctree(['/' + menu.name for menu in menus])}")
        for source in [*DOCS.rglob("*"), *(ROOT / name for name in TOP_PAGES)]:
            at = place(source) if source.is_file() else None
            if at is None or source == FRONT:
                continue
            if source.suffix == ".md":
                beside = sorted(p.stem for p in source.parent.glob("*.md") if p != source)
                menu = _toctree(beside) if source.name == "README.md" and source.parent != ROOT else ""
                self.page(source, at, f"{source.read_text(encoding='utf-8')}\n{menu}")
            else:
                self._copy(source, at)
        self._copy(SETTINGS / "conf.py", "conf.py")
        self._copy(SETTINGS / "site.css", "_static/site.css")

    def page(self, source: Path, at: str, text: str) -> None:
        """Write a page whose links are relative to ``source``, so that they hold at ``at``."""
        parts = _FENCED.split(text)  # every second part is code
        for index in range(0, len(parts), 2):
            parts[index] = _LINK.sub(lambda found: self._link(found, source, at), parts[index])
        path = self.folder / at
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(parts), encoding="utf-8")

    def _link(self, found: re.Match[str], source: Path, at: str) -> str:
        mark, text, target, anchor = found.groups(default="")
        path = (source.parent / target).resolve()
        if not target or ":" in target or not path.exists():
            return found[0]
        if path.is_dir():
            path /= "README.md"
        to = place(path)
        if to is None:
            to = "_files/" + path.relative_to(ROOT).as_posix() + (".txt" if path.suffix == ".md" else "")
            self._copy(path, to)
        return f"{mark}[{text}]({os.path.relpath(to, Path(at).parent)}{anchor})"

    def _copy(self, source: Path, at: str) -> None:
        (self.folder / at).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, self.folder / at)


def _toctree(entries: list[str]) -> str:
    return "\n".join(["```{toctree}", ":hidden:", "", *entries, "```", ""])


def build(output: Path, source: Path) -> int:
    """Assemble the pages in ``source`` and build them into ``output``; return Sphinx' exit status."""
    from sphinx.cmd.build import main as sphinx

    Assembly(source).everything()
    doctrees = str(source / "_doctrees")
    return sphinx(["-q", "-W", "--keep-going", "-n", "-d", doctrees, str(source), str(output)])


def main(arguments: list[str] | None = None) -> int:
    """Build the site; return 0 if there was no warning."""
    parser = argparse.ArgumentParser(description="Build the documentation site from docs/.")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "build" / "site", help="folder")
    output: Path = parser.parse_args(arguments).output
    with tempfile.TemporaryDirectory() as folder:
        status = build(output, Path(folder))
    print(f"{output / 'index.html'}" if status == 0 else "the site has warnings, see above")
    return status


if __name__ == "__main__":
    sys.exit(main())
