"""Sphinx' settings for the documentation site; ``tools/build_site.py`` runs it over the pages of docs/."""

from __future__ import annotations

from importlib.metadata import version as installed_version

project = "canest"
author = "the canest authors"
project_copyright = "the canest authors, MIT licence"
release = version = installed_version("canest")

extensions = ["myst_parser"]
myst_heading_anchors = 4  # links to headings are those that GitHub makes
nitpicky = True
suppress_warnings = ["misc.highlighting_failure"]  # SQL with the macros of Grafana is no plain SQL
exclude_patterns = ["_files"]
myst_links_external_new_tab = False
highlight_language = "none"

html_theme = "pydata_sphinx_theme"
html_title = f"canest {release}"
html_show_sourcelink = False
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {
    "logo": {"text": "canest"},
    "header_links_before_dropdown": 7,
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "navbar_align": "left",
    "article_header_end": [],
    "footer_start": ["copyright"],
    "footer_end": [],
}
