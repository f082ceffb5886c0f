"""Many vehicles, many logs: replayed on all cores or a Dask cluster into a lake of Parquet files."""
