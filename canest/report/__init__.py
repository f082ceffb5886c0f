"""Self-contained HTML reports: one file, opens without network (extra `report`: plotly's script, jinja2)."""
