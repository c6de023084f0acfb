"""Toolkit: files dropped into the publisher that are face performances become items.

A collector hook for tk-multi-publish2, made to stand after the app's own:
``collector: "{self}/collector.py:{config}/usdface/collect_face_performance.py"``.
"""

from pathlib import Path

import sgtk

HookBaseClass = sgtk.get_hook_baseclass()

LAYERS = (".usda", ".usdc", ".usd")


class FacePerformanceCollector(HookBaseClass):
    """Make an item ``usdface.performance`` of every performance; leave other files to the rest."""

    def process_file(self, settings, parent_item, path):
        """Look at one file.

        Parameters
        ----------
        settings : dict
        parent_item : item
            Under which the new one goes.
        path : str

        Returns
        -------
        item or None
        """
        item = self._performance(parent_item, Path(path)) if path.endswith(LAYERS) else None
        return super().process_file(settings, parent_item, path) if item is None else item

    def _performance(self, parent_item, path):
        from usdface.core.errors import UsdfaceError
        from usdface.publish import collect_performances

        try:
            (found,) = collect_performances([path])
        except UsdfaceError as error:
            self.logger.debug("%s is no face performance: %s", path, error)
            return None
        item = parent_item.create_item("usdface.performance", "Face Performance", found.name)
        item.properties["path"] = str(path)  # and nothing that JSON cannot hold: trees are saved
        return item
