"""Every mistake is one plain line that names the place, and the right exit code."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from canest.system.shipped_files import shipped

DATA = Path(__file__).parents[1] / "data"
KENWORTH = DATA / "kenworth" / "normal.log.xz"
CLASS8 = shipped("configs") / "class8.yaml"


def one_line(done) -> str:
    assert "Traceback" not in done.err
    lines = done.err.strip().splitlines()
    assert len(lines) == 1, done.err
    return lines[0]


def test_without_arguments_the_help_is_shown_as_it_is(canest):
    done = canest()
    assert done.code == 2
    assert done.out == ""
    assert done.err.startswith("Usage: canest ")
    assert "\n  replay " in done.err


def changed_config(folder: Path, old: str, new: str) -> Path:
    text = CLASS8.read_text()
    assert old in text
    path = folder / "truck.yaml"
    path.write_text(text.replace(old, new))
    return path


class TestUsage:
    def test_no_such_command_names_the_nearest(self, canest):
        done = canest("reply", "x.log")
        assert done.code == 2
        assert "expected a command, perhaps replay" in one_line(done)

    def test_unknown_option(self, canest):
        done = canest("replay", KENWORTH, "-c", "kenworth", "--wat")
        assert done.code == 2
        assert "--wat" in one_line(done)

    def test_missing_config(self, canest):
        done = canest("replay", KENWORTH)
        assert done.code == 2
        assert "-c CONFIG" in one_line(done)

    def test_speed_without_a_bus(self, canest):
        done = canest("replay", KENWORTH, "-c", "kenworth", "--speed", "2")
        assert done.code == 2
        assert "--to" in one_line(done)

    def test_malformed_bus(self, canest):
        done = canest("replay", KENWORTH, "--to", "vcan0")
        assert done.code == 2
        assert "INTERFACE:CHANNEL" in one_line(done)

    def test_one_truth_for_several_logs(self, canest):
        done = canest("replay", KENWORTH, KENWORTH, "-c", "kenworth", "--truth", "truth.csv")
        assert done.code == 2
        assert "--truth auto" in one_line(done)

    @pytest.mark.parametrize("command", [["replay"], ["compare", "--mass", "9000"]])
    @pytest.mark.parametrize("mass_kg", ["1e9", "39000", "300"])
    def test_a_start_mass_that_the_vehicle_cannot_have(self, canest, command, mass_kg):
        done = canest(*command, KENWORTH, "-c", "kenworth", "--initial-mass", mass_kg)
        assert done.code == 2
        assert "--initial-mass: no mass of this vehicle" in one_line(done)
        assert "expected 4000 to 36000 kg" in done.err

    @pytest.mark.parametrize("option", [["-o", "est.csv"], ["-o", "est.parquet"], ["--report", "est.html"]])
    def test_one_file_for_several_logs(self, canest, tmp_path, monkeypatch, option):
        monkeypatch.chdir(tmp_path)
        done = canest("replay", KENWORTH, KENWORTH, "-c", "kenworth", *option)
        assert done.code == 2
        assert f"{option[0]}: found the file {option[1]}, expected a directory" in one_line(done)
        assert not list(tmp_path.iterdir())

    def test_no_truth_beside_the_log(self, canest):
        done = canest("replay", KENWORTH, "-c", "kenworth", "--truth", "auto")
        assert done.code == 2
        assert "normal.truth.csv" in one_line(done)

    def test_compare_without_truth(self, canest):
        done = canest("compare", KENWORTH, "-c", "kenworth")
        assert done.code == 2
        assert "--truth" in one_line(done)

    def test_unknown_estimator_lists_the_known(self, canest):
        done = canest("replay", KENWORTH, "-c", "kenworth", "--estimator", "magic")
        assert done.code == 2
        assert "--estimator: unknown estimator, found 'magic'" in one_line(done)
        assert "rlsmf" in done.err

    def test_a_start_mass_that_is_no_number_of_kilograms(self, canest):
        done = canest("check", "-c", "kenworth", "--initial-mass", "-3")
        assert done.code == 2
        assert "--initial-mass, found -3.0, expected greater than 0" in one_line(done)


class TestConfig:
    def test_negative_mass_names_file_and_line(self, canest, tmp_path):
        path = changed_config(tmp_path, "mass_min_kg: 7000", "mass_min_kg: -7000")
        done = canest("check", "-c", path)
        assert done.code == 2
        line = next(i for i, text in enumerate(path.read_text().splitlines(), 1) if "-7000" in text)
        assert f"{path}:{line}" in one_line(done)
        assert "found -7000" in done.err

    def test_unknown_key_lists_the_known(self, canest, tmp_path):
        path = changed_config(tmp_path, "wheel_radius_m:", "wheel_diameter_m:")
        done = canest("check", "-c", path)
        assert done.code == 2
        message = one_line(done)
        assert f"{path}:" in message
        assert "wheel_diameter_m" in message or "wheel_radius_m" in message

    def test_signal_that_no_dbc_has(self, canest, tmp_path):
        path = changed_config(tmp_path, "signal: EngSpeed,", "signal: EngineSped,")
        done = canest("check", "-c", path)
        assert done.code == 2
        message = one_line(done)
        assert "signals.engine_speed" in message
        assert "EngineSped" in message
        assert "EngSpeed" in message

    def test_unit_of_another_dimension(self, canest, tmp_path):
        path = changed_config(tmp_path, "signal: EngSpeed,", "signal: EngSpeed, unit: kg,")
        done = canest("check", "-c", path)
        assert done.code == 2
        assert "kg" in one_line(done)

    def test_cutoff_at_nyquist_is_refused_with_the_reason(self, canest):
        done = canest("check", "-c", "class8", "--set", "filter.cutoff_hz=25")
        assert done.code == 2
        assert "half the 50 Hz" in one_line(done)

    def test_override_is_named_as_the_culprit(self, canest):
        done = canest("check", "-c", "class8", "--set", "vehicle.wheel_radius_m=55")
        assert done.code == 2
        assert "--set" in one_line(done)

    def test_a_config_that_cannot_work_is_reported_once_for_many_logs(self, canest):
        option = "estimator.options.forgeting=0.9"
        done = canest("replay", KENWORTH, KENWORTH, "-c", "kenworth", "--set", option)
        assert done.code == 2
        assert "--set: estimator.options.forgeting: unknown option" in one_line(done)

    def test_no_yaml(self, canest, tmp_path):
        path = tmp_path / "broken.yaml"
        path.write_text("vehicle: {\n")
        done = canest("check", "-c", path)
        assert done.code == 2
        assert "broken.yaml" in one_line(done)

    def test_no_such_config_lists_the_shipped(self, canest):
        done = canest("check", "-c", "no-such-truck")
        assert done.code == 2
        assert "class8.yaml" in one_line(done)

    def test_bare_on_and_off_are_words(self, canest):
        for word in ("off", "on", "on+save"):
            assert canest("check", "-c", "class8", "--set", f"service.learn={word}").code == 0

    @pytest.mark.parametrize("name", sorted(p.stem for p in shipped("configs").glob("*.yaml")))
    def test_shipped_configs_are_right(self, canest, name):
        done = canest("check", "-c", name)
        assert done.code == 0
        assert "config is right" in done.out


class TestLogs:
    def test_no_such_log(self, canest, tmp_path):
        done = canest("replay", tmp_path / "none.log", "-c", "kenworth")
        assert done.code == 1
        assert "none.log" in one_line(done)

    @pytest.mark.parametrize("name", ["est.tsv", "est.csv.xz", "est.xlsx", "est.html"])
    def test_estimates_are_written_in_no_format_but_their_own(self, canest, tmp_path, name):
        done = canest("replay", KENWORTH, "-c", "kenworth", "-o", tmp_path / name)
        assert done.code == 2
        assert f"{name}', expected a name that ends in .csv or .parquet" in one_line(done)
        assert not list(tmp_path.iterdir())

    def test_no_log_at_all(self, canest, tmp_path):
        path = tmp_path / "picture.png"
        path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 20)
        done = canest("replay", path, "-c", "kenworth")
        assert done.code == 1
        assert "picture.png" in one_line(done)

    @pytest.mark.parametrize("command", [["replay"], ["check"], ["compare", "--mass", "9000"]])
    def test_a_channel_that_the_log_lacks_names_those_it_has(self, canest, command):
        done = canest(*command, KENWORTH, "-c", "kenworth", "--channel", "can7")
        assert done.code == 1
        line = one_line(done)
        assert "no frame on this channel, found 'can7', expected one of can0 (19,957 frames)" in line

    @pytest.mark.parametrize(
        "command", [["replay"], ["compare", "--mass", "9000"], ["diagnose", "-o", "out"]]
    )
    def test_table_log_for_a_config_of_dbc_signals(self, canest, tmp_path, monkeypatch, command):
        monkeypatch.chdir(tmp_path)
        path = tmp_path / "table.csv"
        path.write_text("t_s,v\n0.0,1\n0.1,2\n")
        done = canest(*command, path, "-c", "kenworth")
        assert done.code == 1
        assert "DBC signals" in one_line(done)
        assert [p.name for p in tmp_path.iterdir()] == ["table.csv"]

    def test_output_that_cannot_be_written(self, canest, tmp_path):
        done = canest("replay", KENWORTH, "-c", "kenworth", "-o", tmp_path / "none" / "est.csv")
        assert done.code == 1
        assert "est.csv" in one_line(done)

    def test_full_disk(self, canest):
        done = canest("replay", KENWORTH, "-c", "kenworth", "-o", "/dev/full")
        assert done.code == 1
        assert "/dev/full" in one_line(done)

    def test_an_estimator_that_compare_does_not_know(self, canest):
        done = canest("compare", KENWORTH, "-c", "kenworth", "--mass", "7700", "--only", "canest,magic")
        assert done.code == 2
        assert one_line(done).startswith("error: --only: unknown estimator, found 'magic', expected one of ")

    def test_truth_of_another_shape(self, canest, tmp_path):
        path = tmp_path / "truth.csv"
        path.write_text("t_s,colour\n0,1\n")
        done = canest("replay", KENWORTH, "-c", "kenworth", "--truth", path)
        assert done.code == 1
        assert "truth.csv" in one_line(done)


class TestProcess:
    """What only a process of its own shows."""

    def run(self, *arguments: str, **options) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "canest", *arguments],
            check=False,
            capture_output=True,
            text=True,
            timeout=60,
            **options,
        )

    def test_debug_shows_the_traceback(self):
        plain = self.run("check", "-c", "no-such-truck")
        verbose = self.run("check", "-c", "no-such-truck", "--debug")
        assert plain.returncode == verbose.returncode == 2
        assert "Traceback" not in plain.stderr
        assert "Traceback" in verbose.stderr

    @pytest.mark.parametrize("arguments", [("replay", "--json", "-"), ("replay",), ("check",)])
    def test_reader_that_has_seen_enough(self, arguments):
        read, write = os.pipe()
        os.close(read)
        command, *options = arguments
        process = subprocess.run(
            [sys.executable, "-m", "canest", command, str(KENWORTH), "-c", "kenworth", *options],
            check=False,
            stdout=write,
            stderr=subprocess.PIPE,
            text=True,
            timeout=60,
        )
        os.close(write)
        assert process.stderr == ""
        assert process.returncode == 0

    @pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
    def test_closed_streams_lose_no_work(self, tmp_path, closed):
        command = f"{sys.executable} -m canest replay {KENWORTH} -c kenworth -o {tmp_path}/e.csv {closed}"
        done = subprocess.run(["sh", "-c", command], check=False, capture_output=True, timeout=60)
        assert (done.returncode, done.stderr) == (0, b"")
        assert (tmp_path / "e.csv").stat().st_size > 10_000

    @pytest.mark.parametrize(
        "ascii_only", [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"}]
    )
    def test_a_terminal_without_the_sign_for_a_degree(self, ascii_only):
        ascii_only = os.environ | {"PYTHONUTF8": "0"} | ascii_only
        arguments = ["compare", str(KENWORTH), "-c", "kenworth", "--mass", "7700", "--only", "rls"]
        done = self.run(*arguments, env=ascii_only)
        assert done.returncode == 0, done.stderr
        assert "grade RMS ?" in done.stdout

    def test_version(self):
        from canest import __version__

        done = self.run("--version")
        assert done.returncode == 0
        assert __version__ in done.stdout

    def test_an_interrupt_while_the_command_is_imported_is_no_traceback(self):
        code = (
            "import sys\n"
            "class Interrupt:\n"
            "    def find_spec(self, name, path, target=None):\n"
            "        if name == 'canest.cli.main':\n"
            "            raise KeyboardInterrupt\n"
            "sys.meta_path.insert(0, Interrupt())\n"
            "from canest.__main__ import main\n"
            "main()\n"
        )
        process = subprocess.run(
            [sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=60
        )
        assert (process.returncode, process.stderr) == (1, "interrupted\n")

    def test_help_imports_nothing_heavy(self):
        code = (
            "import sys\n"
            "from canest.cli.main import run\n"
            "run(['replay', '--help'])\n"
            "heavy = {'numpy', 'scipy', 'pydantic', 'cantools', 'can', 'rich', 'numba', 'yaml', 'plotly'}\n"
            "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
        )
        process = subprocess.run(
            [sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=60
        )
        assert process.returncode == 0, process.stderr
        assert "Examples:" in process.stdout

    def test_replay_imports_nothing_that_it_does_not_use(self):
        code = (
            "import sys\n"
            "from canest.cli.main import run\n"
            f"run(['replay', {str(KENWORTH)!r}, '-c', 'kenworth'])\n"
            "heavy = {'scipy', 'can', 'rich', 'numba', 'plotly', 'pyarrow', 'multiprocessing'}\n"
            "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
        )
        process = subprocess.run(
            [sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=60
        )
        assert process.returncode == 0, process.stderr
