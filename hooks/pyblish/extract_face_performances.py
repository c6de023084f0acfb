"""Pyblish: extract weights with edits, a layer to open, and a sheet."""

import os
from pathlib import Path

import pyblish.api


class ExtractFacePerformance(pyblish.api.InstancePlugin):
    """Make the files of a version in a temporary folder.

    The folder of publishes is ``context.data["usdfaceRoot"]`` or the environment variable
    USDFACE_PUBLISH_ROOT; ``instance.data["usdfaceReview"]``, a `usdface.publish.ReviewOptions`,
    sets the pictures for review.
    """

    label = "Extract face performance"
    order = pyblish.api.ExtractorOrder
    families = ["facePerformance"]  # noqa: RUF012
    hosts = ["*"]  # noqa: RUF012

    def process(self, instance):
        """Extract the instance."""
        from usdface.core.errors import InputError
        from usdface.publish import extract_performance

        root = instance.context.data.get("usdfaceRoot") or os.environ.get("USDFACE_PUBLISH_ROOT")
        if not root:
            raise InputError(
                "no folder to publish to: set USDFACE_PUBLISH_ROOT, or usdfaceRoot in the context"
            )
        instance.data["usdfaceExtracted"] = extract_performance(
            instance.data["usdfaceItem"],
            Path(root),
            review=instance.data.get("usdfaceReview"),
            progress=lambda fraction, message: self.log.debug("%.0f%% %s", 100 * fraction, message),
        )
