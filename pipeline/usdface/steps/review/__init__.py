"""Sheets, movies, reports and figures to judge a performance by."""

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
