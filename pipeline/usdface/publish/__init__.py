"""Publish performances: what every studio tool's hooks share, and none of their words.

Four stages, as publish tools have them: `collect_performances`, `validate_performance`,
`extract_performance`, `integrate_performance`.
"""

from usdface.publish.collect import PublishItem, collect_performances, validate_performance
from usdface.publish.extract import Extracted, ReviewOptions, extract_performance
from usdface.publish.integrate import Published, integrate_performance

__all__ = [
    "Extracted",
    "PublishItem",
    "Published",
    "ReviewOptions",
    "collect_performances",
    "extract_performance",
    "integrate_performance",
    "validate_performance",
]
