"""Pyblish: integrate the extracted files as a version."""

import pyblish.api


class IntegrateFacePerformance(pyblish.api.InstancePlugin):
    """Publish the files as the next version; unchanged ones are not published again."""

    label = "Integrate face performance"
    order = pyblish.api.IntegratorOrder
    families = ["facePerformance"]  # noqa: RUF012
    hosts = ["*"]  # noqa: RUF012

    def process(self, instance):
        """Integrate the instance."""
        from usdface.publish import integrate_performance

        published = integrate_performance(
            instance.data["usdfaceExtracted"], comment=instance.context.data.get("comment", "")
        )
        instance.data["usdfacePublished"] = published
        state = "is published" if published.is_new else "was published already"
        self.log.info("%s v%03d %s: %s", published.name, published.version, state, published.folder)


class DiscardFacePerformance(pyblish.api.ContextPlugin):
    """Remove extracted files of a publish that stopped before integration."""

    label = "Tidy up face performances"
    order = pyblish.api.IntegratorOrder + 0.49
    hosts = ["*"]  # noqa: RUF012

    def process(self, context):
        """Remove extracted files without a version."""
        for instance in context:
            if "usdfaceExtracted" in instance.data and "usdfacePublished" not in instance.data:
                instance.data["usdfaceExtracted"].discard()
