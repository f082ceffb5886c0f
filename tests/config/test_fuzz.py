"""Whatever a config file holds, it loads or it is refused in one line; nothing else happens."""

from __future__ import annotations

import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from canest.config import parse_config
from canest.core.errors import ConfigError
from canest.pipeline.pipeline import Pipeline
from canest.system.shipped_files import shipped

TEXTS = [p.read_text() for p in sorted(shipped("configs").glob("*.yaml"))]
TREES = [yaml.safe_load(text) for text in TEXTS]

scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**12), 10**12),
    st.integers(-3, 30),
    st.floats(allow_nan=True, allow_infinity=True),
    st.text(max_size=8),
    st.sampled_from(["headwind", "crank", "on", "gear", "vehicle_speed", "km/h", "j1939.dbc", "0x10"]),
)
values = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=6), inner, max_size=3)
    ),
    max_leaves=6,
)


def check(text: str, *overrides: str) -> None:
    """Load, and build everything that a config decides."""
    try:
        config = parse_config(text, "fuzz.yaml", overrides)
        if config.estimator.name == "canest":
            Pipeline(config)
    except ConfigError as error:
        assert "\n" not in str(error)


@settings(max_examples=150, deadline=None)
@given(st.text(max_size=80))
@example("a: &a [*a]\nb: *a")
@example("&a {*a : 1}")
@example("? {a: 1}\n: 2")
@example("a: !!python/object:os.system {}")
@example("1: 2\nnull: 3\ntrue: 4")
@example("vehicle: &v {<<: *v}")
def test_any_text(text: str) -> None:
    check(text)


@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from(TEXTS),
    st.lists(st.tuples(st.floats(0, 1), st.integers(0, 12), st.text(max_size=6)), min_size=1, max_size=4),
)
def test_a_shipped_config_with_damage(text: str, wounds: list[tuple[float, int, str]]) -> None:
    for place, deleted, inserted in wounds:
        at = int(place * len(text))
        text = text[:at] + inserted + text[at + deleted :]
    check(text)


def leaves(tree: object, path: tuple[object, ...] = ()) -> list[tuple[object, ...]]:
    if not isinstance(tree, dict):
        return [path]
    return [path, *(p for key, value in tree.items() for p in leaves(value, (*path, key)))]


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_a_shipped_config_with_another_value_somewhere(data: st.DataObject) -> None:
    tree = yaml.safe_load(yaml.safe_dump(data.draw(st.sampled_from(TREES))))
    *parents, last = data.draw(st.sampled_from(leaves(tree)[1:]))
    section = tree
    for key in parents:
        section = section[key]
    section[last] = data.draw(values)
    check(yaml.safe_dump(tree, allow_unicode=True))


@settings(max_examples=100, deadline=None)
@given(st.text(alphabet="abgfilter._=0123456789{}[]:,-é ", max_size=25))
@example("filter.order=" + "9" * 5000)
@example("vehicle=1")
@example("a.b.c.d=1")
def test_any_override(override: str) -> None:
    check(TEXTS[0], override)
