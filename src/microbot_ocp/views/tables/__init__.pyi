"""Public names; loaded when they are first asked for."""

from ._comparison import (
    comparison_rows as comparison_rows,
    comparison_table as comparison_table,
    narrow_table as narrow_table,
    write_csv as write_csv,
    write_json as write_json,
)
