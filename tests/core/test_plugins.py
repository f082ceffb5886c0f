"""Entry points of other packages: loaded when asked for, and skipped with a reason when they cannot be."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from canest.core.plugins import load_plugins

GROUP = "canest.test_group"


@pytest.fixture(autouse=True)
def _forget() -> Iterator[None]:
    load_plugins.cache_clear()
    yield
    load_plugins.cache_clear()


def installed(folder: Path, package: str, entries: str, source: str = "") -> None:
    """Lay out a package as an installer would: a module and its metadata."""
    (folder / f"{package}.py").write_text(source)
    info = folder / f"{package}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{GROUP}]\n{entries}\n")


def test_no_package_gives_anything() -> None:
    assert load_plugins(GROUP) == ({}, {})


def test_an_object_is_loaded_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed(tmp_path, "plugin_good", "seven = plugin_good:SEVEN", "SEVEN = 7\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert load_plugins(GROUP) == ({"seven": 7}, {})


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("raise OSError('no\\nlicence')\n", "OSError: no licence"),
        ("import no_such_library\n", "ModuleNotFoundError: No module named 'no_such_library'"),
        ("raise SystemExit(3)\n", "SystemExit: 3"),
        ("", "AttributeError: module 'plugin_bad' has no attribute 'WANTED'"),
    ],
)
def test_what_cannot_be_imported_is_named_and_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, reason: str
) -> None:
    monkeypatch.delitem(sys.modules, "plugin_bad", raising=False)
    installed(tmp_path, "plugin_bad", "wanted = plugin_bad:WANTED", source)
    installed(tmp_path, "plugin_fine", "fine = plugin_fine:FINE", "FINE = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    loaded, skipped = load_plugins(GROUP)
    assert loaded == {"fine": 1}
    assert skipped == {"wanted": f"plugin_bad:WANTED of plugin_bad cannot be imported: {reason}"}


def test_a_name_that_two_packages_give_is_nobodys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed(tmp_path, "plugin_one", "same = plugin_one:X", "X = 1\n")
    installed(tmp_path, "plugin_two", "same = plugin_two:X", "X = 2\n")
    monkeypatch.syspath_prepend(tmp_path)
    loaded, skipped = load_plugins(GROUP)
    assert loaded == {}
    assert skipped == {
        "same": "several packages give it: plugin_one:X of plugin_one, plugin_two:X of plugin_two"
    }
