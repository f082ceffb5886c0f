"""What is in the tables of one log: samples at any rate, positions only where they are asked for."""

from __future__ import annotations

import io
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import yaml

from canest.fleet.bundle import bundle_of
from canest.fleet.job import FleetJob, Outcome, Settings
from canest.fleet.manifest import Rule
from canest.fleet.process_log import process_log
from canest.fleet.result_names import log_id
from canest.fleet.source import FoundLog
from canest.system.shipped_files import shipped
from tests.fleet.conftest import candump


@pytest.fixture(scope="module")
def config(tmp_path_factory) -> Path:
    """The Kenworth's config with the roles of a position."""
    content = yaml.safe_load((shipped("configs") / "kenworth.yaml").read_text())
    for role in ("latitude", "longitude"):
        content["signals"][role] = {"message": "VP1", "signal": role.title(), "optional": True}
    path = tmp_path_factory.mktemp("config") / "truck.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def outcome_of(folder: Path, config: Path, settings: Settings, name: str = "a.log") -> Outcome:
    """Process a log of 6 s in which the vehicle reports 47.5 N, 8.25 E once a second."""
    raw = b"".join(round((degrees + 210) * 1e7).to_bytes(4, "little") for degrees in (47.5, 8.25))
    text = candump(6, 1_700_000_000)
    for second in range(7):
        text += b"(%d.500000) can0 18FEF31C#%s\n" % (1_700_000_000 + second, raw.hex().upper().encode())
    lines = sorted(text.splitlines(), key=lambda line: float(line[1:].split(b")")[0]))
    log = folder / name
    log.write_bytes(b"\n".join(lines) + b"\n")
    bundle = bundle_of(str(config))
    rules = ((Rule("*", "truck", str(config)), bundle.digest),)
    found = process_log(FleetJob(FoundLog(name, str(log), 1), rules), {bundle.digest: bundle}, settings)
    assert not found.error
    return found


def samples(outcome: Outcome) -> pq.Table:
    (content,) = (c for name, c in outcome.files.items() if name.startswith("samples/"))
    return pq.read_table(io.BytesIO(content))


def test_positions_are_kept_only_where_they_are_asked_for(tmp_path, config):
    plain = samples(outcome_of(tmp_path, config, Settings()))
    assert not {"latitude_deg", "longitude_deg"} & set(plain.column_names)
    asked = samples(outcome_of(tmp_path, config, Settings(positions=True)))
    assert asked["latitude_deg"].to_pylist()[-1] == pytest.approx(47.5)
    assert asked["longitude_deg"].to_pylist()[-1] == pytest.approx(8.25)


def test_samples_come_as_often_as_asked(tmp_path, config):
    every = samples(outcome_of(tmp_path, config, Settings(samples_hz=50)))
    once = samples(outcome_of(tmp_path, config, Settings(samples_hz=1)))
    assert len(every) > 45 * len(once)
    assert once["t_s"].to_pylist() == [t for t in every["t_s"].to_pylist() if t == round(t)]
    none = outcome_of(tmp_path, config, Settings(samples_hz=0))
    assert [name.split("/")[0] for name in none.files] == ["trips"]


def test_settings_that_change_the_tables_change_the_key(tmp_path, config):
    keys = {
        outcome_of(tmp_path, config, settings).key
        for settings in (Settings(), Settings(positions=True), Settings(samples_hz=0))
    }
    assert len(keys) == 3


def test_names_that_are_no_utf8_are_in_the_tables_as_python_writes_them(tmp_path, config):
    odd = tmp_path / "\udcff.yaml"
    odd.write_text(config.read_text())
    outcome = outcome_of(tmp_path, odd, Settings(), "\udcff.log")
    assert set(samples(outcome)["log"].to_pylist()) == {r"\udcff.log"}
    (row,) = pq.read_table(io.BytesIO(outcome.files[outcome.written])).to_pylist()
    assert (row["log"], row["config"]) == (r"\udcff.log", r"\udcff.yaml")
    # compact finds the rows of a log by the digest of its name
    assert log_id(row["log"]) in outcome.written
