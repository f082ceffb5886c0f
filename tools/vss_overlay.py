"""Writes the overlay of canest's VSS signals: ``python tools/vss_overlay.py --write``.

``vss/canest.vspec`` is for vss-tools, which merges it into a vehicle's own tree. ``vss/canest.json`` is what
vss-tools make of it; a KUKSA databroker loads it beside the standard's tree.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from canest.publish.vss import BRANCH, BRANCH_TEXT, SIGNALS  # noqa: E402

HEAD = "# Made by tools/vss_overlay.py: signals of `canest publish kuksa`. vss-tools merge it (option -l)."
ROOT_TEXT = "High-level vehicle data."


def entries() -> dict[str, dict[str, Any]]:
    """Return the entries of the overlay by path."""
    found: dict[str, dict[str, Any]] = {BRANCH: {"description": BRANCH_TEXT, "type": "branch"}}
    for name, signal in SIGNALS.items():
        entry: dict[str, Any] = {
            "datatype": signal.datatype, "description": signal.description, "type": "sensor",
        }  # fmt: skip
        if signal.unit:
            entry["unit"] = signal.unit
        if signal.allowed:
            entry["allowed"] = list(signal.allowed)
        found[f"{BRANCH}.{name}"] = entry
    return found


def vspec() -> str:
    """Return the overlay as YAML for vss-tools."""
    blocks = {"Vehicle": {"description": ROOT_TEXT, "type": "branch"}, **entries()}
    lines = [HEAD]
    for path, entry in blocks.items():
        lines += ["", f"{path}:", *(f"  {key}: {json.dumps(value)}" for key, value in entry.items())]
    return "\n".join(lines) + "\n"


def tree() -> str:
    """Return the overlay as the JSON tree that a databroker loads."""
    branch, *signals = entries().items()
    children = {path.rpartition(".")[2]: entry for path, entry in signals}
    own = {**branch[1], "children": dict(sorted(children.items()))}
    root = {"description": ROOT_TEXT, "type": "branch", "children": {BRANCH.rpartition(".")[2]: own}}
    return json.dumps({"Vehicle": root}, indent=2, sort_keys=True) + "\n"


FILES = {ROOT / "vss" / "canest.vspec": vspec, ROOT / "vss" / "canest.json": tree}


if __name__ == "__main__":
    for path, content in FILES.items():
        if "--write" in sys.argv:
            path.write_text(content())
        else:
            print(content(), end="")
