"""A log whose clock was set back by an hour: time goes on in all that comes of it, and nothing is lost."""

from __future__ import annotations

import numpy as np
import pytest

import canest
from canest.core.errors import OutputError
from canest.core.frames import FrameBlock
from canest.doctor.check import Doctor
from canest.fleet.job import Settings
from canest.fleet.manifest import Manifest, Rule
from canest.fleet.query import ask
from canest.fleet.run import Request, run_fleet
from canest.logs import open_log
from canest.logs.blf_writer import BlfFrames
from canest.logs.candump_writer import candump_text
from canest.node.broadcast_log import RecordedLog, open_broadcast_log
from canest.offline.replay import Output, replay
from canest.report.recorder import Recorder
from canest.report.replay_page import _facts

BACK_US = 3_600_000_000
START_US = 1_700_000_000_000_000


@pytest.fixture(scope="module")
def drive():
    return canest.demo_drive()


@pytest.fixture(scope="module")
def log(drive, tmp_path_factory):
    """60 s of a drive, an hour back for its second half; in lines of a candump log."""
    frames = drive.frames[drive.frames.t_us < drive.frames.t_us[0] + 60_000_000]
    back = frames.t_us - frames.t_us[0] >= 30_000_000
    t_us = frames.t_us - np.where(back, BACK_US, 0)
    path = tmp_path_factory.mktemp("back") / "back.log"
    path.write_bytes(candump_text(FrameBlock(t_us, frames.can_id, frames.length, frames.data)))
    return path


def frames_of(path):
    return FrameBlock.concatenate(list(open_log(path)))


@pytest.mark.parametrize("beside", [False, True])
@pytest.mark.parametrize("suffix", [".log", ".blf"])
def test_estimates_are_sent_before_and_after(drive, log, tmp_path, beside, suffix):
    path = tmp_path / f"est{suffix}"
    recorded = RecordedLog(log) if beside else None

    def opened(path, more):
        return open_broadcast_log(drive.config.broadcast, recorded, path, more)

    replay(log, drive.config, output=Output(path, (), opened))
    found = frames_of(path)
    own = found.can_id & 0xFFFF00 == 0xFF5A00
    at_s = (found.t_us[own] - frames_of(log).t_us.min()) / 1e6
    assert ((at_s >= 0.0) & (at_s < 30.1)).sum() == pytest.approx(150, abs=3)
    assert (at_s > 3_000.0).sum() == pytest.approx(150, abs=3)
    if beside:
        assert (~own).sum() == len(frames_of(log))
        assert (np.diff(found.t_us) < -1000).sum() == 1  # in the order of the log


def test_a_blf_refuses_a_time_before_its_first(log, tmp_path):
    with (tmp_path / "both.blf").open("wb") as file:
        writer = BlfFrames(file, tmp_path / "both.blf")
        writer.write(FrameBlock.from_frames([(START_US + 5, 1, b""), (START_US, 1, b"")]))
        with pytest.raises(OutputError, match=r"set back .*expected a name that ends in \.log"):
            writer.write(FrameBlock.from_frames([(START_US - BACK_US, 1, b"")]))
        writer.close()


def test_durations_are_those_of_the_drive(drive, log, tmp_path):
    doctor = Doctor(drive.config)
    reader = open_log(log)
    for block in reader:
        doctor.push(block)
    assert doctor.report(reader).duration_s == pytest.approx(60.0, abs=0.1)
    recorder = Recorder()
    result = replay(log, drive.config, listener=recorder)
    assert dict(_facts(result.summary, recorder))["duration"] == "1:00 min"
    stamps, columns = recorder.columns()
    assert np.ptp(stamps) == pytest.approx(60e6, abs=1e6) and (np.diff(stamps) >= 0).all()
    assert np.ptp(columns["clock_us"]) > 3_500e6
    (leg,) = result.summary["legs"]
    assert leg["to_s"] < leg["from_s"] and "passed_us" not in leg


def test_a_leg_of_the_lake_has_its_duration_and_its_residual(log, tmp_path):
    source = log.parent
    request = Request(
        source.as_posix(), str(tmp_path / "lake"), Manifest((Rule("*", "truck-1", "class8"),)), Settings()
    )
    run_fleet(request, lambda logs: None, lambda outcome: None, lambda: None)
    sql = "select duration_s, driving_s, residual_rms_N from trips"
    ((duration_s, driving_s, residual_N),) = ask(str(tmp_path / "lake"), sql).rows()
    assert float(duration_s) == pytest.approx(60.0, abs=1.0) == float(driving_s)
    assert float(residual_N) > 0.0
