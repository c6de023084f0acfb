"""Toolkit: publish a face performance as a version, and register it.

A publish plug-in for tk-multi-publish2, to be added after the app's:
``hook: "{self}/publish_file.py:{config}/usdface/publish_face_performance.py"``. Properties of items
are serialisable as JSON, because publishers save their trees to continue in another process.
"""

from pathlib import Path

import sgtk

HookBaseClass = sgtk.get_hook_baseclass()


class FacePerformancePublishPlugin(HookBaseClass):
    """Publish an item ``usdface.performance`` as a version; the base class registers it."""

    @property
    def name(self):
        """One line in the publisher's list."""
        return "Publish face performance"

    @property
    def description(self):
        """Description in the publisher."""
        return (
            "Publishes weights with the animator's edits, a layer to open and a contact sheet as a "
            "new version, unless they equal the newest version."
        )

    @property
    def settings(self):
        """Settings of the base class, and of this plug-in."""
        return dict(super().settings or {}) | {
            "Publish Root": {
                "type": "str",
                "default": "",
                "description": "Folder of publishes, with a folder for each performance.",
            },
            "Sheet": {
                "type": "bool",
                "default": True,
                "description": "Draw a contact sheet, which becomes the thumbnail.",
            },
            "File Type": {
                "type": "str",
                "default": "USD Face Performance",
                "description": "Published file type to register.",
            },
        }

    @property
    def item_filters(self):
        """Accepted types of items."""
        return ["usdface.performance"]

    def accept(self, settings, item):
        """Accept all performances."""
        return {"accepted": True, "checked": True}

    def validate(self, settings, item):
        """Return whether the item can be published."""
        from usdface.publish import collect_performances, validate_performance

        if not settings["Publish Root"].value:
            self.logger.error("the setting 'Publish Root' is empty: name a folder to publish to")
            return False
        (found,) = collect_performances([Path(item.properties["path"])])
        fit = True
        for finding in validate_performance(found):
            if finding.severity == "error":
                fit = False
                self.logger.error("%s: %s", finding.where, finding.message)
            else:
                self.logger.warning("%s: %s", finding.where, finding.message)
        return fit

    def publish(self, settings, item):
        """Make the version; the base class registers it unless it is registered already."""
        from usdface.publish import (
            ReviewOptions,
            collect_performances,
            extract_performance,
            integrate_performance,
        )

        (found,) = collect_performances([Path(item.properties["path"])])
        extracted = extract_performance(
            found,
            Path(settings["Publish Root"].value),
            review=ReviewOptions(sheet=settings["Sheet"].value),
        )
        try:
            published = integrate_performance(extracted, comment=item.description or "")
        except Exception:
            extracted.discard()
            raise
        item.properties["usdfaceVersion"] = published.version
        item.properties["usdfaceFolder"] = str(published.folder)
        item.local_properties["publish_path"] = str(published.files["performance"])
        # The base class would copy `path` to `publish_path` if they differed.
        item.local_properties["path"] = item.local_properties["publish_path"]
        item.local_properties["publish_name"] = published.name
        item.local_properties["publish_version"] = published.version
        item.local_properties["publish_type"] = settings["File Type"].value
        item.local_properties["publish_dependencies"] = [
            str(path) for path in (found.rig, found.take) if path is not None
        ]
        if "sheet" in published.files:
            item.set_thumbnail_from_path(str(published.files["sheet"]))
        item.properties["usdfaceRegistered"] = published.is_new or not self._registered(item)
        if item.properties["usdfaceRegistered"]:
            super().publish(settings, item)
        else:
            self.logger.info("v%03d is the same already", published.version)

    def finalize(self, settings, item):
        """Log the folder of the version."""
        if item.properties["usdfaceRegistered"]:
            super().finalize(settings, item)
        folder = item.properties["usdfaceFolder"]
        self.logger.info(
            "%s v%03d: %s",
            item.name,
            item.properties["usdfaceVersion"],
            folder,
            extra={"action_show_folder": {"path": folder}},
        )

    def _registered(self, item):
        """Return whether the server has the version, which an interrupted publish may lack."""
        known = self.parent.util.get_conflicting_publishes(
            item.context,
            item.local_properties["publish_path"],
            item.local_properties["publish_name"],
        )
        if known:
            item.properties["sg_publish_data"] = known[0]  # for items below this one
        return bool(known)
