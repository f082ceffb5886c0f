"""What a person edited is not overwritten silently."""

from __future__ import annotations

import pytest

SCENARIO = """
duration_s: 4
vehicle: electric-car
mass_kg: 1500
driver: {kind: cruise, speed_mps: 10}
"""
NAMES = ("mine.log", "mine.truth.csv", "mine.yaml")


@pytest.fixture
def simulate(canest, tmp_path):
    scenario = tmp_path / "mine.yaml"
    scenario.write_text(SCENARIO)
    out = tmp_path / "out"

    def run(*options):
        done = canest("simulate", scenario, "-o", out, *options)
        return done, {p.name: p.read_bytes() for p in out.iterdir()}

    return run, out


def test_a_simulation_overwrites_its_own_files(simulate):
    run, _ = simulate
    done, first = run()
    assert done.code == 0 and set(first) == set(NAMES)
    assert run() == (done, first)
    other, changed = run("--seed", 7)
    assert other.code == 0
    assert all(changed[name] != first[name] for name in ("mine.log", "mine.yaml"))


@pytest.mark.parametrize("name", NAMES)
def test_but_none_that_was_edited_since(simulate, name):
    run, out = simulate
    run()
    with (out / name).open("ab") as file:
        file.write(b"# mine\n")
    edited = {p.name: p.read_bytes() for p in out.iterdir()}
    for options in ([], ["--seed", 7]):
        done, found = run(*options)
        assert done.code == 2
        assert done.err.startswith(f"error: {out / name}: exists, and was edited")
        assert "--force" in done.err
        assert found == edited
    done, found = run("--force")
    assert done.code == 0
    assert found != edited
    assert run()[0].code == 0


def test_nor_one_that_is_not_of_its_making(simulate):
    run, out = simulate
    out.mkdir()
    (out / "mine.log").write_text("a drive that somebody recorded\n")
    done, found = run()
    assert done.code == 2
    assert found == {"mine.log": b"a drive that somebody recorded\n"}


def test_the_unit_of_the_service_likewise(canest, tmp_path):
    unit = tmp_path / "etc/systemd/system/canest@.service"
    install = ("install-service", "--install", "--root", tmp_path)
    assert canest(*install).code == 0
    text = unit.read_text()
    assert canest(*install).code == 0
    unit.write_text(text.replace("WatchdogSec=10", "WatchdogSec=30"))
    assert unit.read_text() != text
    done = canest(*install)
    assert done.code == 2
    assert "canest@.service: exists, and was edited" in done.err and "--force" in done.err
    assert "WatchdogSec=30" in unit.read_text()
    assert canest(*install, "--force").code == 0
    assert unit.read_text() == text


def test_a_unit_that_was_printed_into_place_may_be_installed_over(canest, tmp_path):
    unit = tmp_path / "etc/systemd/system/canest@.service"
    unit.parent.mkdir(parents=True)
    unit.write_text(canest("install-service").out)
    assert canest("install-service", "--install", "--root", tmp_path).code == 0
