"""Public names; loaded when they are first asked for."""

from ._tables import (
    comparison_markdown as comparison_markdown,
    comparison_notes as comparison_notes,
    comparison_rows as comparison_rows,
    comparison_table as comparison_table,
    narrow_table as narrow_table,
    note_sentences as note_sentences,
    table_title as table_title,
    write_csv as write_csv,
    write_json as write_json,
)
