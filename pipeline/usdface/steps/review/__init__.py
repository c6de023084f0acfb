"""Sheets, movies, reports and figures to judge a performance by."""
