"""Publishing of performances, shared by the hooks of all studio tools.

In the four usual stages: `collect_performances`, `validate_performance`, `extract_performance`,
`integrate_performance`.
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
