"""demo, compare, simulate: short runs of the real thing."""

from __future__ import annotations

import json
import lzma
import time

import pytest

from canest.cli.main import COMMANDS
from canest.demo import DRIVE, TRUTH
from tests.cli.conftest import KENWORTH


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_teaches_with_examples(canest, name):
    done = canest(name, "--help")
    assert done.code == 0, done.err
    assert f"canest {name}" in done.out
    assert "Examples" in done.out


def test_help_lists_every_command(canest):
    done = canest("--help")
    assert done.code == 0
    for name in COMMANDS:
        assert name in done.out


def test_demo_settles_near_the_truth(canest):
    done = canest("demo", "--speed", "60")
    assert done.code == 0, done.err
    assert "valid" in done.out
    assert "at the end" in done.out
    end = next(line for line in done.out.splitlines() if line.startswith("at the end"))
    assert abs(float(end.rsplit(":", 1)[1].split("%")[0])) < 8


def test_demo_waits_for_a_daemon_that_is_slower_than_the_drive():
    from canest.demo.session import Session

    with Session(60.0) as session:
        push = session.daemon.pipeline.push

        def late(frames):
            time.sleep(0.6)  # longer than an estimate is one of now, so "not available" is sent meanwhile
            return push(frames)

        session.daemon.pipeline.push = late
        last = list(session.play(1.0))[-1]
        estimates, _ = session.finish()
    assert abs(last.estimate.mass_kg / last.true_mass_kg - 1) < 0.08
    assert (estimates.t_us[-1] - estimates.t_us[0]) * 1e-6 == pytest.approx(session.duration_s, abs=0.1)


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("bus.channel=vcan0", "bus"),
        ("bus.interface=socketcan", "bus"),
        ("bus={interface: socketcan, channel: can0}", "bus"),
        ("bus.bitrate=250000", "bus"),
        ("service.log_estimates=est.csv", "service.log_estimates"),
    ],
)
def test_demo_refuses_what_it_has_of_its_own(canest, override, key):
    done = canest("demo", "--set", override)
    assert done.code == 2
    assert done.err.startswith(f"error: --set: {key}: is the demo's own, which plays to itself")
    assert done.err.count("\n") == 1


def test_demo_names_the_option_that_is_wrong(canest):
    done = canest("demo", "--initial-mass", "3")
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("error: --initial-mass: no mass of this vehicle, found 3, expected 7000 to")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("demo --speed nan", "from 0.1 to 60."),
        ("demo --speed 61", "from 0.1 to 60."),
        ("check -c class8 --live --seconds nan", "from 0.1 on."),
        ("check -c class8 --live --seconds inf", "from 0.1 on."),
        ("monitor virtual:a --for nan", "from 0 on."),
        ("monitor virtual:a --for -1", "from 0 on."),
        ("publish mqtt --broker mqtt://localhost --rate nan", "from 0.01 to 50."),
        ("publish kuksa --rate nan", "from 0.01 to 50."),
        ("fleet run logs -o lake --memory nan", "from 100 on."),
        ("fleet run logs -o lake --timeout inf", "from 1 on."),
        ("compare a.log -c class8 --mass 9", "from 50 kg on."),
    ],
)
def test_a_number_that_cannot_be_is_refused(canest, arguments, expected):
    done = canest(*arguments.split())
    *_, option, given = arguments.split()
    assert done.code == 2
    assert f"'{option}': found {given}, expected a number {expected}" in done.err


def test_compare_and_diagnose_warn_of_the_log_as_replay_does(canest, tmp_path):
    lines = lzma.decompress(KENWORTH.read_bytes()).splitlines(keepends=True)
    late = [line.replace(b"(0", b"(9", 1) for line in lines[-200:]]
    log = tmp_path / "flawed.log"
    log.write_bytes(b"".join([lines[0], b"no frame\n", *lines[1:], *late]))
    message = canest("replay", log, "-c", "kenworth", "--json", tmp_path / "replay.json")
    notes = json.loads((tmp_path / "replay.json").read_text())["notes"]
    assert "line 2 skipped" in notes[0] and "1 gaps" in notes[1]
    notes = [note for note in notes if "stale" not in note]  # which `replay` and `check` name
    message = canest(
        "compare", log, "-c", "kenworth", "--mass", "7700", "--only", "rls",
        "--json", tmp_path / "compare.json", "--report", tmp_path / "compare.html",
    )  # fmt: skip
    assert json.loads((tmp_path / "compare.json").read_text())["notes"] == notes
    assert all(note in message.out for note in notes)
    assert "line 2 skipped" in (tmp_path / "compare.html").read_text("utf-8")
    message = canest("diagnose", log, "-c", "kenworth", "--mass", "7700", "-o", tmp_path / "found")
    data = json.loads((tmp_path / "found/diagnosis.json").read_text("utf-8"))["data"]
    assert data["notes"] == {str(log): notes}
    assert f"note: flawed.log: {'; '.join(notes)}" in message.out
    assert "line 2 skipped" in (tmp_path / "found/report.html").read_text("utf-8")


def test_compare_on_the_bundled_drive(canest, tmp_path):
    done = canest(
        "compare", DRIVE, "-c", "class8", "--truth", TRUTH, "--only", "canest,rlsmf,dgo",
        "--json", tmp_path / "c.json", "--interpreted",
    )  # fmt: skip
    assert done.code == 0, done.err
    table = json.loads((tmp_path / "c.json").read_text())
    assert set(table["estimators"]) == {"canest", "rlsmf", "dgo"}
    assert table["default"] == "canest"
    for row in table["estimators"].values():
        assert set(row) == {
            "mass_end_pct", "mass_rms_pct", "mass_max_pct", "grade_rms_deg", "to_5pct_s", "ns_per_sample",
            "note",
        }  # fmt: skip
    assert table["estimators"]["dgo"]["mass_rms_pct"] is None
    assert "canest" in done.out


def test_simulate_lists_and_makes_drives(canest, tmp_path):
    listing = canest("simulate", "--list")
    assert "pulse-21t" in listing.out
    scenario = tmp_path / "short.yaml"
    scenario.write_text("duration_s: 20\nvehicle: class8\nmass_kg: 20000\ndriver: {kind: pulses}\n")
    done = canest("simulate", scenario, "-o", tmp_path / "out", "--compress", "--seed", "3")
    assert done.code == 0, done.err
    made = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert made == ["short.log.xz", "short.truth.csv", "short.yaml"]
    replayed = canest(
        "replay", tmp_path / "out" / "short.log.xz", "-c", tmp_path / "out" / "short.yaml", "--json", "-"
    )
    assert replayed.code == 0, replayed.err
    assert json.loads(replayed.out)["samples"] > 900


def test_scenario_mistake_names_its_line(canest, tmp_path):
    scenario = tmp_path / "wrong.yaml"
    scenario.write_text("duration_s: 20\nvehicle: class8\nmass_kg: -5\ndriver: {kind: pulses}\n")
    done = canest("simulate", scenario, "-o", tmp_path)
    assert done.code == 2
    assert "wrong.yaml" in done.err
