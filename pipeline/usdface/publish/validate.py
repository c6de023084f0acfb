"""Check that a performance is fit to be published."""

from usdface.publish.collect import PublishItem
from usdface.usdio.validation import Finding, validate


def validate_performance(item: PublishItem) -> tuple[Finding, ...]:
    """Return what is not in order in a performance, errors first; empty where nothing is.

    Raises
    ------
    InputError
        If the file cannot be opened.
    """
    found = list(validate(item.performance))
    if item.take is None:
        found.append(
            Finding(
                "warning",
                "usdface:take",
                str(item.performance),
                "does not say what it was mapped from, or that is gone: it is published without a "
                "sheet to judge it by; map it again to have one",
            )
        )
    return tuple(sorted(found, key=lambda finding: finding.severity != "error"))
