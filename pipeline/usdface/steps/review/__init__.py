"""Sheets, movies, reports and error measures of performances."""

_helpers = (
    "clock",
    "evaluation_tables",
    "head_turn",
    "pictures",
    "report_parts",
    "report_tables",
    "scoring",
    "sheet_columns",
    "shot",
)
