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
        products = {}
        for item in found:
            product = _product_name(item.name)
            other = products.setdefault(product.casefold(), item)
            if other is not item:
                raise publish.PublishError(
                    f"{item.performance}: its product would be {product}, as that of "
                    f"{other.performance}; rename one of the files",
                    title="Face performances",
                )
            instance = context.create_instance(item.name)
            instance.data.update(
                {
                    "productType": "facePerformance",
                    "productBaseType": "facePerformance",
                    "productName": product,
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
    """Return a name of letters, digits, ``_`` and ``.``, as AYON requires.

    Other letters are their code points, so that names of them alone stay different.
    """
    letters = "".join(each if each.isalnum() or each == "." else "_" for each in name)
    kept = "".join(each if each.isascii() else f"u{ord(each):04x}" for each in letters)
    return kept.strip(".") or "_"
