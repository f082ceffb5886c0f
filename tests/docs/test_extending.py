"""The page for other packages, and the table of effects, are what the classes say."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

from canest.vehicle.effects import EFFECTS, Effect
from canest.vehicle.effects.base import Added, Scaled
from canest.vehicle.effects.registry import PLUGIN_STAGES, unfit

ROOT = Path(__file__).resolve().parents[2]
EXTENDING = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")


def test_the_table_of_effects_is_made_from_the_classes():
    tool = runpy.run_path(str(ROOT / "tools" / "effects_table.py"))
    text = tool["PAGE"].read_text(encoding="utf-8")
    assert tool["table"]() in text, "python tools/effects_table.py --write"
    assert all(f"| `{name}` |" in text for name in EFFECTS)


def test_the_table_of_constants_is_made_from_the_code():
    tool = runpy.run_path(str(ROOT / "tools" / "constants_table.py"))
    assert tool["table"]() in tool["PAGE"].read_text(encoding="utf-8"), "tools/constants_table.py --write"


def test_the_effect_on_the_page_is_one_and_is_the_examples():
    source = next(s for s in re.findall(r"```python\n(.*?)```", EXTENDING, re.DOTALL) if "TrailerDrag" in s)
    space: dict[str, object] = {"__name__": "page"}
    exec(compile(source, "extending.md", "exec", dont_inherit=True), space)
    assert unfit("trailer_drag", space["TrailerDrag"]) == ""
    example = (ROOT / "examples/canest-trailer-drag/canest_trailer_drag/__init__.py").read_text("utf-8")
    for line in filter(None, source.split("class TrailerDrag(Effect):")[1].splitlines()):
        assert line.split("#")[0].rstrip().split("->")[0] in example, line


def test_every_stage_and_attribute_of_an_effect_has_its_row():
    for stage in PLUGIN_STAGES:
        assert f"| `{stage}` |" in EXTENDING
    own = {"name", "text", "parameters", "stage", "apply"}  # in the steps above the table
    made = {"amount", "caused_by", "fitted_parameter", "in_words", "to_config"}  # from the others
    for name in {n for n in vars(Effect) if not n.startswith("_")} - own - made:
        assert f"| `{name}`" in EXTENDING or f"| `{name}(" in EXTENDING, name
    assert issubclass(Added, Effect) and issubclass(Scaled, Effect)
