"""Pages keep to short sentences, and the links of those that people write lead somewhere."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))

import prose  # noqa: E402

PAGES = prose.pages()
MADE = [*sorted((ROOT / "docs" / "measured").glob("*.md")), ROOT / "docs" / "commands.md"]


@pytest.mark.parametrize("page", [*PAGES, *MADE], ids=lambda p: str(p.relative_to(ROOT)))
def test_no_sentence_is_too_long(page):
    assert prose.measured(page.read_text(encoding="utf-8")).too_long() == []


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
        if not target.startswith(("http:", "https:")):
            assert (page.parent / target).exists(), target


def test_pages_that_programs_write_are_no_pages_of_people():
    assert ROOT / "README.md" in PAGES
    assert ROOT / "docs" / "faults.md" in PAGES
    assert not set(PAGES) & set(MADE)


def lengths(markdown):
    return [prose.words(s) for s in prose.measured(markdown).running]


def test_sentences_end_at_full_stops_items_and_blank_lines():
    assert lengths("One two. Three four five!\nSix seven\n\neight\n- nine\n- ten eleven") == [
        2,
        3,
        2,
        1,
        1,
        2,
    ]


def test_abbreviations_numbers_and_code_end_no_sentence():
    assert lengths("It needs 0.25 s, e.g. `a. B c` (eq. 24).") == [8]


def test_a_sentence_may_begin_with_code():
    assert lengths("It is on. `canest run` starts it.") == [3, 3]


def test_code_formulas_and_comments_do_not_count():
    text = (
        "Run this:\n\n    one two three four\n\n```sh\nfive six\n```\n\n$$ a + b $$\n\n"
        "$$\nc d e\n$$\n<!-- x y -->\nIt works.\n"
    )
    assert lengths(text) == [2, 2]


def test_code_within_a_list_item_does_not_count():
    assert lengths("1. Do it:\n\n       canest run now\n\n   Then look.\n") == [2, 2]


def test_cells_are_apart_and_crowded_ones_are_counted():
    found = prose.measured(
        "| fault | what |\n|---|---|\n| none | It stops. Then it starts. |\n| a | `x | y` b |\n"
    )
    assert found.running == []
    assert found.crowded_cells == [" It stops. Then it starts. "]
    assert prose.words(found.longest) == 3


def test_long_sentences_are_found_in_text_and_in_cells():
    long = " ".join(["word"] * 41)
    assert len(prose.measured(f"{long}.\n\n| {long} |\n").too_long()) == 2
    assert prose.measured(f"{long[5:]}.").too_long() == []
