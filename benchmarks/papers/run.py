"""The three papers' experiments again: figures and tables beside the papers' own numbers.

    python benchmarks/papers/run.py -o DIR|PAGE.md [--drives FOLDER] [--only 2005|2013|2014]

It takes about a minute. A name that ends in .md is written as Markdown,
with its figures in a folder beside it.

FOLDER may hold recorded drives (NAME.log[.xz] with NAME.truth.csv) named as the shipped scenarios; those of
the same kind are evaluated beside the simulated ones.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import kidambi2014
import rhode2013
import vahidi2005
from data import simulated  # noqa: F401 - puts the checkout on the path before canest is imported
from page import Page

import canest
from canest.core import jit

PAPERS = {"2005": vahidi2005.write, "2013": rhode2013.write, "2014": kidambi2014.write}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the page, or PAGE.md")
    parser.add_argument("--drives", type=Path, help="folder of recorded drives")
    parser.add_argument("--only", choices=PAPERS, help="one paper only")
    arguments = parser.parse_args()
    jit.enable()
    page = Page(arguments.output, "The papers' experiments, run again with canest")
    page.text(
        "Every number below is measured by this program when it runs; the papers' own numbers stand beside "
        "it. The papers measured on real vehicles; here the vehicle is a simulation with known truth that "
        "is richer than the estimators' model (torque lag, reporting steps, driveline losses, sensor "
        "noise, lost frames). Boxes say why numbers differ."
    )
    page.text(f"Run with canest {canest.__version__} on {time.strftime('%Y-%m-%d')}, with fixed seeds:")
    page.code("python benchmarks/papers/run.py -o docs/measured/papers.md")
    for year, write in PAPERS.items():
        if arguments.only in (None, year):
            begin = time.perf_counter()
            write(page, arguments.drives)
            print(f"{year}: {time.perf_counter() - begin:.1f} s", flush=True)
    print(page.write())
    return 0


if __name__ == "__main__":
    sys.exit(main())
