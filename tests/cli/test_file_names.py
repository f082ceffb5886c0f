"""A name of a file that is no UTF-8 stands in every file as Python writes it, and costs no result."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from canest.system.result_files import write_result
from canest.system.shipped_files import shipped

SHOWN = r"\udcff\udcfe"


@pytest.fixture
def canest(canest):
    """The command line, with a stdout that takes such a name."""

    def call(*arguments):
        sys.stdout.reconfigure(errors="replace")
        return canest(*arguments)

    return call


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / os.fsdecode(b"\xff\xfe.log")
    path.write_text("(1.000000) can0 0CF00400#F18585641300FFFF\n(2.000000) can0 0CF00400#F18585641300FFFF\n")
    return path


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / os.fsdecode(b"\xff\xfe.yaml")
    path.write_text((shipped("configs") / "class8.yaml").read_text())
    return path


def test_text_is_written_as_utf8_and_the_rest_as_python_has_it(tmp_path):
    write_result(tmp_path / "a.txt", "größer \udcff")
    assert (tmp_path / "a.txt").read_bytes() == "größer \\udcff".encode()


@pytest.mark.parametrize("command", [["replay"], ["compare", "--mass", "20000", "--only", "rls"]])
def test_a_report_names_the_log(canest, tmp_path, log, config, command):
    done = canest(*command, log, "-c", config, "--report", tmp_path / "r.html")
    assert done.code == 0, done.err
    assert SHOWN in (tmp_path / "r.html").read_text("utf-8")


def test_the_index_of_several_reports_leads_to_the_file(canest, tmp_path, log, config):
    (tmp_path / "b.log").write_bytes(log.read_bytes())
    done = canest("replay", log, tmp_path / "b.log", "-c", config, "--report", tmp_path / "r")
    assert done.code == 0, done.err
    assert f'<a href="%FF%FE.html">{SHOWN}' in (tmp_path / "r" / "index.html").read_text("utf-8")
    assert (tmp_path / "r" / os.fsdecode(b"\xff\xfe.html")).is_file()


def test_a_diagnosis_names_log_and_config(canest, tmp_path, log, config):
    done = canest("diagnose", log, "-c", config, "--mass", "20000", "-o", tmp_path / "d")
    assert done.code == 0, done.err
    document = json.loads((tmp_path / "d" / "diagnosis.json").read_text("utf-8"))
    assert document["data"]["logs"] == [str(log)]
    assert SHOWN in (tmp_path / "d" / "report.html").read_text("utf-8")
