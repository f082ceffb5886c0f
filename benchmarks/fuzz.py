"""Fuzzes everything that reads what others wrote: logs, frames, transport, state file, config.

    python benchmarks/fuzz.py [--minutes 10] [--target NAME] [--plain]

Targets: logs, bam, decoder, pipeline, node, state, config, or all. A mutation that reaches new lines
of canest joins the seeds; with atheris installed (`pip install atheris`; needed only here) libFuzzer does
the same, faster, unless --plain. A finding is an exception other than CanestError, an input that takes over a
second of CPU (20 under atheris, whose instrumented code is that much slower), an estimate nobody could
believe, or memory that grows by over 300 MB. Its input is kept in --keep, and the exit code is 1.
`tests/fuzz` runs the same targets for seconds, and every input that was ever found.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import os
import subprocess
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

#: code that reports every branch is some twenty times slower: what it may take instead of 1 s
INSTRUMENTED_S = 20.0
NAMES = ("logs", "bam", "decoder", "pipeline", "node", "state", "config")


def guided(name: str, seconds: float, keep: Path) -> None:
    """Coverage-guided; libFuzzer ends the process."""
    import atheris

    with atheris.instrument_imports(include=["canest"]):
        import canest.live.state
        import canest.logs.others
        import canest.pipeline.pipeline  # noqa: F401
    from tests.fuzz.engine import run_one
    from tests.fuzz.targets import TARGETS

    target = TARGETS[name]
    with tempfile.TemporaryDirectory(prefix="canest-corpus.") as folder:
        for k, data in enumerate(target.seeds()):
            (Path(folder) / str(k)).write_bytes(data)
        options = [f"-max_total_time={seconds:.0f}", "-timeout=30", "-rss_limit_mb=2000", "-max_len=40000",
                   f"-artifact_prefix={keep}/{name}-", "-print_final_stats=1"]  # fmt: skip
        if target.tokens:
            words = Path(folder).with_suffix(".dict")
            lines = ("".join(f"\\x{b:02x}" for b in token[:60]) for token in target.tokens if token)
            words.write_text("".join(f'"{line}"\n' for line in lines))
            options.append(f"-dict={words}")
        atheris.Setup([sys.argv[0], folder, *options], lambda data: run_one(target, data, INSTRUMENTED_S))
        atheris.Fuzz()


def traced(name: str, seconds: float, keep: Path, seed: int) -> int:
    """Guided by line coverage, on Python's own tracing."""
    from tests.fuzz.engine import Finding, fuzz
    from tests.fuzz.targets import TARGETS

    try:
        print(fuzz(TARGETS[name], seconds, seed), flush=True)
    except Finding as finding:
        path = keep / f"{name}-{hashlib.sha1(finding.data).hexdigest()[:12]}"
        path.write_bytes(finding.data)
        print(f"{name}: FOUND {finding}\n  kept as {path}")
        import traceback

        traceback.print_exception(finding.__cause__ or finding)
        return 1
    return 0


def main() -> int:
    """Run one target here, or all of them one after another, each in a process of its own."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="of each target")
    parser.add_argument("--target", choices=[*NAMES, "all"], default="all")
    parser.add_argument("--plain", action="store_true", help="without atheris, even where it is installed")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-findings"))
    parser.add_argument("--seed", type=int, default=int.from_bytes(os.urandom(4), "little"))
    args = parser.parse_args()
    if args.target == "all":
        command = [sys.executable, __file__, *sys.argv[1:], "--target"]
        return max(subprocess.run([*command, name], check=False).returncode != 0 for name in NAMES)
    args.keep.mkdir(parents=True, exist_ok=True)
    seconds = args.minutes * 60.0
    if importlib.util.find_spec("atheris") and not args.plain:
        guided(args.target, seconds, args.keep)
    return traced(args.target, seconds, args.keep, args.seed)


if __name__ == "__main__":
    sys.exit(main())
