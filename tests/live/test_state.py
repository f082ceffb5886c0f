"""The state file: what is restored, what is set aside, and that nothing in it can hurt."""

from __future__ import annotations

import json
import math
import os
import socket
from dataclasses import asdict

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.config import load_config
from canest.core.samples import Status
from canest.live import state
from canest.live.mass_store import MassStore
from canest.live.state import Learned, fingerprint, load, peek, save, unseen_s, vehicle_key, widened_std_kg
from canest.system.files import Background
from canest.system.journal import Journal

NOW_S = 1_800_000_000.0
CONFIG = load_config("vcan")


@pytest.fixture(scope="module")
def shelf(tmp_path_factory):
    return tmp_path_factory.mktemp("state")


def learned(**changes):
    values = {
        "vehicle_key": vehicle_key(CONFIG), "config": fingerprint(CONFIG), "mass_kg": 20_000.0,
        "mass_std_kg": 150.0, "saved_s": NOW_S - 60, "standing": False,
    }  # fmt: skip
    return Learned(**values | changes)


def test_what_is_saved_is_restored(tmp_path):
    path = tmp_path / "deep" / "state.json"
    save(path, learned())
    restored = load(path, CONFIG, NOW_S)
    assert restored.learned == learned() and restored.message == ""
    assert [p.name for p in path.parent.iterdir()] == ["state.json"]


def test_nothing_saved_is_no_reason_for_a_message(tmp_path):
    assert load(tmp_path / "state.json", CONFIG, NOW_S) == state.Restored(None)


@pytest.mark.parametrize(
    ("reason", "content"),
    [
        ("corrupt", b""),
        ("corrupt", b"\x00" * 500),
        ("corrupt", b'{"version": 1, "mass_kg": 20'),
        ("corrupt", b"[1, 2, 3]"),
        ("corrupt", b"\xff\xfe\x00"),
        ("corrupt", b"[" * 60_000),
        ("corrupt", b" " * 1_000_000),
        ("corrupt", json.dumps({"version": 1, "valid": True, "mass_kg": 1}).encode()),
    ],
)
def test_damaged_files_are_set_aside(tmp_path, reason, content):
    path = tmp_path / "state.json"
    path.write_bytes(content)
    restored = load(path, CONFIG, NOW_S)
    assert restored.learned is None and "set aside" in restored.message
    assert not path.exists() and (tmp_path / f"state.json.bad-{reason}").read_bytes() == content


@pytest.mark.parametrize(
    ("reason", "changes"),
    [
        ("version", {"version": 0}),
        ("version", {"version": 99}),
        ("version", {"version": True}),
        ("invalid", {"valid": False}),
        ("vehicle", {"vehicle_key": "another truck"}),
        ("future", {"saved_s": NOW_S + 3600}),
        ("range", {"mass_kg": 100.0}),
        ("range", {"mass_kg": 1e6}),
        ("corrupt", {"mass_kg": math.nan}),
        ("corrupt", {"mass_kg": math.inf}),
        ("corrupt", {"mass_kg": "20000"}),
        ("corrupt", {"mass_kg": True}),
        ("corrupt", {"mass_kg": 10**400}),
        ("corrupt", {"mass_std_kg": 0}),
        ("corrupt", {"mass_std_kg": -5.0}),
        ("corrupt", {"saved_s": None}),
        ("corrupt", {"standing": "no"}),
        ("corrupt", {"vehicle_key": 7}),
        ("corrupt", {"distance_km": "far"}),
        ("corrupt", {"distance_km": math.nan}),
        ("corrupt", {"distance_km": math.inf}),
        ("corrupt", {"distance_km": -1.0}),
        ("corrupt", {"distance_km": 10**400}),
        ("corrupt", {"something_else": 1}),
    ],
)
def test_a_file_that_must_not_be_used_is_set_aside_with_its_reason(tmp_path, reason, changes):
    path = tmp_path / "state.json"
    save(path, learned())
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    restored = load(path, CONFIG, NOW_S)
    assert restored.learned is None
    assert (tmp_path / f"state.json.bad-{reason}").exists() and not path.exists()
    assert "\n" not in restored.message and str(path) in restored.message


def test_a_directory_in_the_files_place_is_reported_and_survived(tmp_path):
    (tmp_path / "state.json").mkdir()
    restored = load(tmp_path / "state.json", CONFIG, NOW_S)
    assert restored.learned is None and "cannot be read" in restored.message


def test_a_second_bad_file_replaces_the_first_one_set_aside(tmp_path):
    path = tmp_path / "state.json"
    for content in (b"first", b"second"):
        path.write_bytes(content)
        load(path, CONFIG, NOW_S)
    assert [p.read_bytes() for p in tmp_path.iterdir()] == [b"second"]


@given(st.binary(max_size=400) | st.text(max_size=200).map(lambda t: t.encode("utf-8", "surrogatepass")))
@settings(max_examples=200, deadline=None)
def test_arbitrary_content_never_raises(shelf, content):
    path = shelf / "state.json"
    path.write_bytes(content)
    assert load(path, CONFIG, NOW_S).learned is None
    path.write_bytes(content)
    assert peek(path) is None


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@given(st.dictionaries(st.sampled_from(["version", "valid", *Learned.__slots__]), json_values, max_size=9))
@settings(max_examples=150, deadline=None)
def test_any_values_in_the_right_places_give_a_sound_state_or_none(shelf, changes):
    path = shelf / "state.json"
    path.write_text(json.dumps({"version": 1, "valid": True, **asdict(learned())} | changes))
    result = load(path, CONFIG, NOW_S).learned
    if result is not None:
        vehicle = CONFIG.vehicle
        assert vehicle.mass_min_kg <= result.mass_kg <= vehicle.mass_max_kg
        assert math.isfinite(widened_std_kg(result, CONFIG))
        assert unseen_s(result, NOW_S) >= 0.0


def test_a_restart_widens_the_mass_and_a_stop_is_time_that_nobody_saw():
    assert 600 <= widened_std_kg(learned(), CONFIG) <= 640  # 3 % of 20 t and what was saved
    assert unseen_s(learned(saved_s=NOW_S - 2), NOW_S) == 0.0  # driving on
    assert unseen_s(learned(saved_s=NOW_S - 2, standing=True), NOW_S) == 2.0
    assert unseen_s(learned(saved_s=NOW_S - 3600), NOW_S) == 3600.0


def test_a_clock_that_is_set_back_does_not_date_the_mass_in_the_future(tmp_path):
    """The mass was valid while the clock was an hour ahead: what is saved is how old it is."""
    wall_s, steady_s = [NOW_S + 3_600.0], [100.0]
    config = load_config("vcan", [f"service.state_dir={tmp_path}", "service.learn=on+save"])
    background = Background()
    store = MassStore(config, background, Journal(), lambda: wall_s[0], lambda: steady_s[0])
    store.update(20_000.0, 100.0, Status.VALID, False, None)
    wall_s[0], steady_s[0] = NOW_S, 110.0
    store.save()
    background.close(5.0)
    restored = load(store.path, config, NOW_S)
    assert restored.learned is not None, restored.message
    assert restored.learned.saved_s == pytest.approx(NOW_S - 10.0)


def test_another_model_of_the_same_vehicle_adds_variance_but_keeps_the_mass():
    other = load_config("vcan", ["vehicle.drag_area_m2=7"])
    assert fingerprint(other) != fingerprint(CONFIG)
    assert widened_std_kg(learned(), other) > widened_std_kg(learned(), CONFIG)


def test_settings_that_do_not_touch_the_model_do_not_change_its_fingerprint():
    assert fingerprint(load_config("vcan", ["bus.channel=can7", "service.save_every_s=5"])) == fingerprint(
        CONFIG
    )


@pytest.mark.parametrize("kind", ["FIFO", "directory", "socket"])
def test_what_is_no_file_is_reported_and_neither_waited_for_nor_replaced(tmp_path, kind):
    path = tmp_path / "state.json"
    with socket.socket(socket.AF_UNIX) as server:
        if kind == "FIFO":
            os.mkfifo(path)
        elif kind == "directory":
            path.mkdir()
        else:
            server.bind(str(path))
        before = path.stat().st_ino
        restored = load(path, CONFIG, NOW_S)
        assert restored.learned is None and "cannot be read (" in restored.message
        assert peek(path) is None
        with pytest.raises(OSError, match=f"is a {kind}, expected a regular file"):
            save(path, learned())
        assert path.stat().st_ino == before
    assert [p.name for p in tmp_path.iterdir()] == ["state.json"]


def test_a_link_in_the_place_of_a_temporary_is_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (tmp_path / ".state.json.tmp").symlink_to(victim)
    save(tmp_path / "state.json", learned())
    assert victim.read_text() == "precious"


def test_what_a_crash_left_of_a_save_is_removed_by_the_next_process_and_no_other_file(tmp_path):
    litter = tmp_path / ".state.json.canest-0123456789abcdef.part"
    own = [
        tmp_path / ".state.json.part",
        tmp_path / "canest-0123456789abcdef.part",
        tmp_path / "state.json.bad-range",
    ]
    for path in (litter, *own):
        path.write_text("half")
    (tmp_path / ".link.canest-0123456789abcdef.part").symlink_to(own[0])
    save(tmp_path / "state.json", learned())
    assert not litter.exists()
    assert len(list(tmp_path.iterdir())) == len(own) + 2 and all(path.read_text() == "half" for path in own)
