"""The file of a map: what is written is read back, and what is no map is refused in one line."""

from __future__ import annotations

import io
from dataclasses import fields

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from canest.config import load_config
from canest.core.errors import ConfigError
from canest.road.build import build_map
from canest.road.table import COLUMNS, RoadMap, read_map, write_map
from tests.road.conftest import drive


@pytest.fixture(scope="module")
def road() -> RoadMap:
    return build_map([drive(0), drive(1, "b")])


def test_what_is_written_is_read_back(road, tmp_path):
    path = tmp_path / "road.parquet"
    path.write_bytes(write_map(road))
    read = read_map(path)
    for column in fields(RoadMap):
        if column.name != "counts":
            assert np.array_equal(getattr(read, column.name), getattr(road, column.name), equal_nan=True)
    assert read.counts == road.counts
    assert pq.read_schema(path).names == list(COLUMNS)


def test_what_is_no_map_is_refused_in_one_line(road, tmp_path):
    path = tmp_path / "road.parquet"
    content = write_map(road)
    table = pq.read_table(io.BytesIO(content))
    beyond = table.set_column(
        table.column_names.index("next"), "next", pa.array([10**6] * len(table), pa.int64())
    )
    other = pa.table({"a": [1]})
    for made, complaint in (
        (b"nonsense", "cannot be read"),
        (content[: len(content) // 2], "cannot be read"),
        (parquet(other), "no road map"),
        (parquet(table.drop_columns(["grade"])), "no road map"),
        (parquet(table.replace_schema_metadata({b"canest.road_map": b"99"})), "version 99"),
        (parquet(beyond), "a cell leads out of the map"),
    ):
        path.write_bytes(made)
        with pytest.raises(ConfigError) as caught:
            read_map(path)
        assert complaint in str(caught.value)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def parquet(table: pa.Table) -> bytes:
    sink = io.BytesIO()
    pq.write_table(table, sink)
    return sink.getvalue()


def test_a_config_takes_its_map_from_beside_it_and_names_one_that_is_missing(road, tmp_path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps/road.parquet").write_bytes(write_map(road))
    config = tmp_path / "truck.yaml"
    shipped = load_config("class8")
    text = shipped.model_dump_json(exclude={"road_map"})
    config.write_text(text[:-1] + ', "road_map": "maps/road.parquet"}')
    assert load_config(str(config)).road_map is not None
    config.write_text(text[:-1] + ', "road_map": "maps/none.parquet"}')
    with pytest.raises(ConfigError, match="road_map"):
        load_config(str(config))
