"""Pages about a lake, and queries of one that has nothing in it yet."""

from __future__ import annotations

import datetime
from pathlib import Path

import pytest

from canest.fleet.forget import forget_vehicle
from canest.fleet.lake import Lake
from canest.fleet.query import ask
from canest.fleet.report import write_report
from canest.fleet.tables import SAMPLES, TRIPS, trips_file
from canest.fleet.vehicle_names import folder_of

START = datetime.datetime(2026, 3, 1, 6)


def put(lake: Lake, vehicle: str, number: int, **columns: object) -> None:
    """Put a trip of one leg into a lake."""
    row = {
        "log": f"{number}.log", "leg": 1, "start": START + datetime.timedelta(days=number), "distance_m": 5e4,
        "duration_s": 3600.0, "driving_s": 3000.0, "climb_m": 200.0, "stops": 1, "mass_kg": 21_000.0,
        "mass_std_kg": 250.0, "valid_share": 0.9, "status": "valid", "reason": "",
        "torque_residual_pct": 0.1 * number,
    }  # fmt: skip
    name = f"trips/{folder_of(vehicle)}/date=2026-03-01/{number:012x}-{number:016x}.parquet"
    lake.storage.write(name, trips_file([row | columns], {}))


@pytest.fixture
def lake(tmp_path):
    made = Lake.create(str(tmp_path / "lake"))
    for number in range(5):
        put(made, "truck <7>", number)
    put(made, "9", 7, mass_kg=None, mass_std_kg=None, status="unestimated", start=None, valid_share=0.0)
    return tmp_path / "lake"


def test_an_index_and_a_page_per_vehicle_share_one_script(lake, tmp_path):
    index, vehicles = write_report(str(lake), str(tmp_path / "report"), lambda share: None)
    assert vehicles == 2
    pages = sorted((tmp_path / "report/vehicles").iterdir())
    text = index.read_text()
    assert "2 vehicles, 6 trips" in text
    for page in pages:
        assert f'href="vehicles/{page.name}"' in text
        assert 'src="../plotly.min.js"' in page.read_text()
        assert page.stat().st_size < 20_000
    assert "truck &lt;7&gt;" in text
    assert "<7>" not in text
    assert (tmp_path / "report/plotly.min.js").stat().st_size > 1e6


def report(folder: Path, lake: Path) -> tuple[str, str]:
    """Write the report of a lake with one vehicle; return both pages."""
    index, _ = write_report(str(lake), str(folder), lambda share: None)
    (page,) = (folder / "vehicles").iterdir()
    return index.read_text(), page.read_text()


def test_a_vehicle_whose_residual_changes_is_named_first_and_one_that_may_be_chance_is_not(tmp_path):
    drifting, steady = Lake.create(str(tmp_path / "a")), Lake.create(str(tmp_path / "b"))
    for number in range(12):
        noise = 0.1 * (-1) ** number
        put(drifting, "t", number, torque_residual_pct=0.1 * number + noise, start=later(5 * number))
        put(steady, "t", number, torque_residual_pct=noise, start=later(5 * number))
    index, page = report(tmp_path / "ra", tmp_path / "a")
    assert "Look at these first" in index
    assert "the residual changes by +1.9 ± 0.2 % in 100 days" in index
    assert '"name":"trend"' in page
    assert 'class="card warn"' in page
    index, page = report(tmp_path / "rb", tmp_path / "b")
    assert "Look at these first" not in index
    assert "± 0.2 %</div>" in page


def test_of_few_trips_or_days_there_is_no_trend(tmp_path):
    few, short = Lake.create(str(tmp_path / "a")), Lake.create(str(tmp_path / "b"))
    for number in range(9):
        put(few, "t", number, start=later(5 * number))
    for number in range(12):
        put(short, "t", number, start=later(number))
    for lake in ("a", "b"):
        index, page = report(tmp_path / f"r{lake}", tmp_path / lake)
        assert "Look at these first" not in index
        assert '"name":"trend"' not in page


def test_a_vehicle_without_a_valid_mass_is_named_with_the_commonest_reason(tmp_path):
    lake = Lake.create(str(tmp_path / "lake"))
    for number, reason in enumerate(["no torque", "no torque", "too short"]):
        put(lake, "t", number, status="unestimated", mass_kg=None, mass_std_kg=None, reason=reason)
    index, _ = report(tmp_path / "report", tmp_path / "lake")
    assert "no valid mass: no torque" in index


def later(days: int) -> datetime.datetime:
    return START + datetime.timedelta(days=days)


def test_a_vehicle_that_is_forgotten_leaves_the_report_too(lake, tmp_path):
    write_report(str(lake), str(tmp_path / "report"), lambda share: None)
    assert forget_vehicle(str(lake), "truck <7>", None) == 5
    write_report(str(lake), str(tmp_path / "report"), lambda share: None)
    assert [p.name for p in (tmp_path / "report/vehicles").iterdir()] == ["vehicle-9.html"]


def test_a_vehicle_of_digits_is_a_name_and_a_log_without_date_has_none(lake):
    rows = list(ask(str(lake), "select vehicle, start, mass_kg from trips where vehicle = '9'").rows())
    assert rows == [["9", "", ""]]


def test_a_lake_without_results_has_both_views(tmp_path):
    Lake.create(str(tmp_path / "lake"))
    for view, columns in (("trips", TRIPS), ("samples", SAMPLES)):
        answer = ask(str(tmp_path / "lake"), f"from {view}")
        assert set(columns) | {"vehicle", "date"} <= set(answer.columns)
        assert list(answer.rows()) == []
