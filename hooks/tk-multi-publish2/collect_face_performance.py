"""Toolkit: collect face performances among files dropped into the publisher.

A collector hook for tk-multi-publish2, to be added after the app's:
``collector: "{self}/collector.py:{config}/usdface/collect_face_performance.py"``.
"""

from pathlib import Path

import sgtk

HookBaseClass = sgtk.get_hook_baseclass()

LAYERS = (".usda", ".usdc", ".usd")


class FacePerformanceCollector(HookBaseClass):
    """Create an item ``usdface.performance`` for each performance; others go to the base class."""

    def process_file(self, settings, parent_item, path):
        """Create the item of a file below `parent_item`."""
        item = self._performance(parent_item, Path(path)) if path.endswith(LAYERS) else None
        return super().process_file(settings, parent_item, path) if item is None else item

    def _performance(self, parent_item, path):
        from usdface.core.errors import UsdfaceError
        from usdface.publish import collect_performances

        try:
            (found,) = collect_performances([path])
        except UsdfaceError as error:
            self.logger.debug("%s is not a face performance: %s", path, error)
            return None
        item = parent_item.create_item("usdface.performance", "Face Performance", found.name)
        item.properties["path"] = str(path)  # serialisable as JSON: trees are saved
        return item
