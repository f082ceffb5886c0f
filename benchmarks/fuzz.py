"""Fuzzes everything that reads what others wrote: logs, frames, transport, state file, config, requests.

    python benchmarks/fuzz.py [--minutes 10] [--target NAME] [--engine NAME]

`make fuzz` runs all of them, ten minutes each. Targets: one per parser (candump, screen, asc, blf, trc,
csv, parquet, db, mf4, gzip, xz, dbc, config, state, bam, slcan, metrics, status), and those that mix them
(logs, decoder, pipeline, node); or all. Engines: atheris (libFuzzer, guided by branches; `pip install -e
'.[fuzz]'`), hypothesis (edits of the seeds, which it shrinks), lines (mutations guided by Python's own
tracing); "both" gives each half of the time to atheris and hypothesis, or to lines where atheris is not
installed. A finding is an exception other than CanestError, an input that takes over a second of CPU (20
under atheris, whose instrumented code is that much slower), an estimate that no vehicle can have, or memory
that grows by over 300 MB. Its input is kept in --keep, by default `tests/fuzz/found`, which the tests
replay, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

#: code that reports every branch is some twenty times slower: what it may take instead of 1 s
INSTRUMENTED_S = 20.0
NAMES = (
    *("candump", "screen", "asc", "blf", "trc", "csv", "parquet", "db", "mf4", "gzip", "xz", "dbc"),
    *("config", "state", "bam", "slcan", "metrics", "status", "logs", "decoder", "pipeline", "node"),
)
ENGINES = ("atheris", "hypothesis", "lines")


def guided(name: str, seconds: float, keep: Path) -> None:
    """Coverage-guided; libFuzzer ends the process."""
    import atheris

    with atheris.instrument_imports(include=["canest"]):
        import canest.live.state
        import canest.logs.python_can
        import canest.pipeline.pipeline  # noqa: F401
    from tests.fuzz.engine import run_one
    from tests.fuzz.targets import all_targets

    target = all_targets()[name]
    with tempfile.TemporaryDirectory(prefix="canest-corpus.") as folder:
        for k, data in enumerate(target.seeds()):
            (Path(folder) / str(k)).write_bytes(data)
        options = [f"-max_total_time={seconds:.0f}", "-timeout=30", "-rss_limit_mb=2000", "-max_len=40000",
                   f"-artifact_prefix={keep}/{name}-", "-print_final_stats=1", "-verbosity=0"]  # fmt: skip
        if target.tokens:
            words = Path(folder).with_suffix(".dict")
            lines = ("".join(f"\\x{b:02x}" for b in token[:60]) for token in target.tokens if token)
            words.write_text("".join(f'"{line}"\n' for line in lines))
            options.append(f"-dict={words}")
        atheris.Setup([sys.argv[0], folder, *options], lambda data: run_one(target, data, INSTRUMENTED_S))
        atheris.Fuzz()


def unguided(name: str, seconds: float, keep: Path, seed: int, engine: str) -> int:
    """Edit seeds, by hypothesis or guided by lines; return the exit code."""
    from tests.fuzz.engine import Finding, fuzz
    from tests.fuzz.shrinking import fuzz_by_hypothesis
    from tests.fuzz.targets import all_targets

    run = fuzz_by_hypothesis if engine == "hypothesis" else fuzz
    try:
        print(run(all_targets()[name], seconds, seed), flush=True)
    except Finding as finding:
        path = keep / f"{name}-{hashlib.sha1(finding.data).hexdigest()[:12]}"
        path.write_bytes(finding.data)
        print(f"{name}: FOUND {finding}\n  kept as {path}")
        traceback.print_exception(finding.__cause__ or finding)
        return 1
    return 0


def one_after_another(names: list[str], engines: list[str], args: argparse.Namespace) -> int:
    """Run every target with every engine, each in a process of its own; return the exit code."""
    minutes = args.minutes / len(engines)
    code = 0
    for name in names:
        for engine in engines:
            command = [sys.executable, __file__, f"--minutes={minutes}", f"--target={name}",
                       f"--engine={engine}", f"--keep={args.keep}", f"--seed={args.seed}"]  # fmt: skip
            print(f"-- {name}, {engine}, {minutes:g} min", flush=True)
            # a process that libFuzzer cannot end (a hang outside Python) must not hold up the others
            try:
                done = subprocess.run(command, check=False, timeout=60 * minutes + 120)
                code = max(code, int(done.returncode != 0))
            except subprocess.TimeoutExpired:
                print(f"{name}: FOUND a hang, or a machine far too busy")
                code = 1
    return code


def main() -> int:
    """Run one target with one engine here, or several one after another."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="of each target")
    parser.add_argument("--target", choices=[*NAMES, "all"], default="all")
    parser.add_argument("--engine", choices=[*ENGINES, "both"], default="both")
    parser.add_argument("--keep", type=Path, default=ROOT / "tests" / "fuzz" / "found")
    parser.add_argument("--seed", type=int, default=int.from_bytes(os.urandom(4), "little"))
    args = parser.parse_args()
    if args.target == "all" or args.engine == "both":
        names = list(NAMES) if args.target == "all" else [args.target]
        guiding = "atheris" if importlib.util.find_spec("atheris") else "lines"
        return one_after_another(
            names, [guiding, "hypothesis"] if args.engine == "both" else [args.engine], args
        )
    args.keep.mkdir(parents=True, exist_ok=True)
    seconds = args.minutes * 60.0
    if args.engine == "atheris":
        guided(args.target, seconds, args.keep)
    return unguided(args.target, seconds, args.keep, args.seed, args.engine)


if __name__ == "__main__":
    sys.exit(main())
