"""Toolkit: publish a face performance as a version, and register it.

A publish plug-in for tk-multi-publish2, made to stand after the app's own:
``hook: "{self}/publish_file.py:USDFACE_HOOKS/tk-multi-publish2/publish_face_performance.py"``.
"""

from pathlib import Path

import sgtk

HookBaseClass = sgtk.get_hook_baseclass()


class FacePerformancePublishPlugin(HookBaseClass):
    """Make a version of an item ``usdface.performance``; the base class registers it."""

    @property
    def name(self):
        """One line in the publisher's list."""
        return "Publish face performance"

    @property
    def description(self):
        """What the publisher shows beside the item."""
        return (
            "Weights with the animator's edits composed in, a layer to open and a contact sheet "
            "become a new version. What equals the newest version is not published again."
        )

    @property
    def settings(self):
        """The base class's settings, and ours."""
        return dict(super().settings or {}) | {
            "Publish Root": {
                "type": "str",
                "default": "",
                "description": "Folder of publishes; each performance has one of its own in it.",
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
        """Kinds of items that this plug-in takes."""
        return ["usdface.performance"]

    def accept(self, settings, item):
        """Take every performance."""
        return {"accepted": True, "checked": True}

    def validate(self, settings, item):
        """Say whether the item is fit to be published."""
        from usdface.publish import validate_performance

        if not settings["Publish Root"].value:
            self.logger.error("the setting 'Publish Root' is empty: name a folder to publish to")
            return False
        fit = True
        for finding in validate_performance(item.properties["usdface"]):
            if finding.severity == "error":
                fit = False
                self.logger.error("%s: %s", finding.where, finding.message)
            else:
                self.logger.warning("%s: %s", finding.where, finding.message)
        return fit

    def publish(self, settings, item):
        """Make the version, then let the base class register it."""
        from usdface.publish import ReviewOptions, extract_performance, integrate_performance

        found = item.properties["usdface"]
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
        item.properties["usdfacePublished"] = published
        if not published.is_new:
            self.logger.info("v%03d holds the same already", published.version)
        item.local_properties["publish_path"] = str(published.files["performance"])
        item.local_properties["publish_name"] = published.name
        item.local_properties["publish_version"] = published.version
        item.local_properties["publish_type"] = settings["File Type"].value
        item.local_properties["publish_dependencies"] = [
            str(path) for path in (found.rig, found.take) if path is not None
        ]
        if "sheet" in published.files:
            item.set_thumbnail_from_path(str(published.files["sheet"]))
        super().publish(settings, item)

    def finalize(self, settings, item):
        """Say where the version is."""
        super().finalize(settings, item)
        published = item.properties["usdfacePublished"]
        self.logger.info(
            "%s v%03d: %s",
            published.name,
            published.version,
            published.folder,
            extra={"action_show_folder": {"path": str(published.folder)}},
        )
