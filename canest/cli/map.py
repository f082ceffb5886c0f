"""`canest map`: the grade of roads, from the drives of a lake."""

from __future__ import annotations

import click

from canest.cli.repeated_options import Group

EPILOG = """\b
Examples (they need the extra map: docs/install.md):
  canest fleet run logs/ -o lake/ --manifest fleet.csv --positions
  canest map build lake/ -o road.parquet
  canest map show road.parquet

\b
Then, in a config:
  road_map: road.parquet
"""

BUILD_EPILOG = """\b
Examples:
  canest map build lake/ -o road.parquet
  canest map build lake/ -o road.parquet --geojson road.geojson    for QGIS or kepler.gl
  canest map build lake/ -o road.parquet --min-passes 3

\b
The lake needs positions: canest fleet run --positions, and roles latitude and longitude in the configs.
"""

SHOW_EPILOG = """\b
Examples:
  canest map show road.parquet               writes road.html
  canest map show road.parquet -o page.html
"""


@click.group(cls=Group, epilog=EPILOG)
def command() -> None:
    """Fuse the grade of roads from many drives into a map, which makes the next drive know it beforehand."""


@command.command(epilog=BUILD_EPILOG)
@click.argument("lake", metavar="LAKE")
@click.option("-o", "--output", "path", required=True, metavar="FILE", help="The map, a Parquet file.")
@click.option("--geojson", "geojson_path", metavar="FILE", help="Write it as GeoJSON too.")
@click.option(
    "--min-passes",
    type=click.IntRange(1),
    default=1,
    show_default=True,
    metavar="N",
    help="Leave out cells with fewer drives.",
)
def build(lake: str, path: str, geojson_path: str | None, min_passes: int) -> None:
    """Build the map of the roads of LAKE: grade per 25 m and direction, with its standard deviation."""
    from pathlib import Path

    from canest.cli.progress import Share
    from canest.fleet.road_drives import drives_of
    from canest.road.build import build_map
    from canest.road.table import write_map
    from canest.system.result_files import write_results

    with Share("map build") as shown:
        road = build_map(drives_of(lake, shown.update), least_passes=min_passes)
    contents = {Path(path): write_map(road)}
    if geojson_path is not None:
        from canest.road.geojson import geojson

        contents[Path(geojson_path)] = geojson(road)
    write_results(contents)
    print("\n".join(f"{count:>9,} {what}" for what, count in road.counts.items()))
    if len(road):
        print(f"grade: +-{_median_deg(road.grade_std):.3f} degrees (one standard deviation, median)")
    print("written " + ", ".join(map(str, contents)))


@command.command(epilog=SHOW_EPILOG)
@click.argument("path", metavar="MAP")
@click.option("-o", "--output", "page_path", metavar="FILE", help="The page (default: MAP with .html).")
def show(path: str, page_path: str | None) -> None:
    """Write a page that shows MAP: its roads coloured by grade. It needs no network."""
    from pathlib import Path

    from canest.report.page import require_packages
    from canest.report.road_page import road_page
    from canest.road.table import read_map

    target = page_path or str(Path(path).with_suffix(".html"))
    require_packages(target)
    road_page(read_map(path), Path(path).name).write(target)
    print(f"written {target}")


def _median_deg(std: object) -> float:
    import numpy as np

    return float(np.degrees(np.median(np.asarray(std, np.float64))))
