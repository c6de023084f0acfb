"""AYON: collect face performances as products."""

import os
from pathlib import Path

import pyblish.api
from ayon_core.pipeline import publish


class CollectFacePerformances(pyblish.api.ContextPlugin):
    """Create an instance, a product of type ``facePerformance``, for each performance.

    Files or folders come from ``context.data["usdface"]`` or from the environment variable
    USDFACE_PUBLISH; folder and task are those of the publish.
    """

    label = "Collect face performances"
    order = pyblish.api.CollectorOrder
    hosts = ["*"]  # noqa: RUF012

    def process(self, context):
        """Add the instances."""
        from usdface.core.errors import UsdfaceError
        from usdface.publish import collect_performances

        named = os.environ.get("USDFACE_PUBLISH", "")
        paths = context.data.get("usdface") or [path for path in named.split(os.pathsep) if path]
        try:
            found = collect_performances(map(Path, paths))
        except UsdfaceError as error:  # AYON reports other classes as errors of the plug-in
            raise publish.PublishError(str(error), title="Face performances") from error
        for item in found:
            instance = context.create_instance(item.name)
            instance.data.update(
                {
                    "productType": "facePerformance",
                    "productBaseType": "facePerformance",
                    "productName": _product_name(item.name),
                    "family": "facePerformance",
                    "families": ["facePerformance"],
                    "folderPath": context.data.get("folderPath"),
                    "task": context.data.get("task"),
                    "frameStart": item.first_frame,
                    "frameEnd": item.last_frame,
                    "handleStart": 0,
                    "handleEnd": 0,
                    "fps": float(item.rate),
                    "source": str(item.performance.absolute()),  # not the host's open scene
                    "representations": [],
                    "usdfaceItem": item,
                }
            )


def _product_name(name):
    """Return a name of letters, digits, ``_`` and ``.``, as AYON requires."""
    kept = "".join(
        each if each.isascii() and (each.isalnum() or each in "_.") else "_" for each in name
    )
    return kept.strip(".") or "_"
