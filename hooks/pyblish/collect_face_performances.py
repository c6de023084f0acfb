"""Pyblish: collect face performances from the host's context or USDFACE_PUBLISH."""

import os
from pathlib import Path

import pyblish.api


class CollectFacePerformances(pyblish.api.ContextPlugin):
    """Create an instance for each performance to publish.

    Files or folders come from ``context.data["usdface"]`` (a list of paths set by a host's
    collector) or from the environment variable USDFACE_PUBLISH.
    """

    label = "Collect face performances"
    order = pyblish.api.CollectorOrder
    hosts = ["*"]  # noqa: RUF012

    def process(self, context):
        """Add the instances."""
        from usdface.publish import collect_performances

        named = os.environ.get("USDFACE_PUBLISH", "")
        paths = context.data.get("usdface") or [path for path in named.split(os.pathsep) if path]
        for item in collect_performances(map(Path, paths)):
            instance = context.create_instance(
                item.name, family="facePerformance", families=["facePerformance", "usd"]
            )
            instance.data["usdfaceItem"] = item
            instance.data["frameStart"], instance.data["frameEnd"] = (
                item.first_frame,
                item.last_frame,
            )
            instance.data["fps"] = float(item.rate)
            self.log.info("%s: frames %d-%d", item.name, item.first_frame, item.last_frame)
