"""What docs/fleet.md shows works on a lake as it is written: pandas, Grafana's SQL, queries."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys

import duckdb
import pytest

from tests.fleet.conftest import ROOT, command

PAGE = (ROOT / "docs/fleet.md").read_text()
QUERIES = re.findall(r"^    canest fleet query lake/ (.+)$", PAGE, re.MULTILINE)


def test_the_pandas_example_runs(lake):
    pytest.importorskip("pandas")
    (script,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    script = script.replace('== "valid"', '!= "valid"')  # of logs this short no mass is valid
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=lake.parent, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "truck-2" in done.stdout


def test_the_query_of_grafana_runs(lake):
    (sql,) = re.findall(r"```sql\n(.*?)```", PAGE, re.DOTALL)
    wide = sql.replace("$__timeFilter(start)", "start BETWEEN '2023-11-01' AND '2023-12-01'")
    wide = wide.replace("/srv/lake", str(lake)).replace("status = 'valid' AND ", "")
    found = duckdb.sql(wide)
    assert found.columns == ["time", "metric", "mass_kg"]
    rows = found.fetchall()
    assert {row[1] for row in rows} == {"truck-1", "truck-2"}
    assert [row[0] for row in rows] == sorted(row[0] for row in rows)


@pytest.mark.parametrize("line", QUERIES, ids=range(len(QUERIES)))
def test_the_queries_run(lake, line):
    (sql, *_) = shlex.split(line.partition(" > ")[0])
    done = command("query", lake, sql)
    assert done.code == 0, done.err
    assert done.out.splitlines()[0].count(",") >= 1
