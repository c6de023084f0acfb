"""Pyblish: the extracted files become a version."""

import pyblish.api


class IntegrateFacePerformance(pyblish.api.InstancePlugin):
    """Give the files the next version number; what has not changed is not published again."""

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
        state = "is published" if published.is_new else "is what was published already"
        self.log.info("%s v%03d %s: %s", published.name, published.version, state, published.folder)


class DiscardFacePerformance(pyblish.api.ContextPlugin):
    """Leave nothing behind where a publish stopped between extraction and integration."""

    label = "Tidy up face performances"
    order = pyblish.api.IntegratorOrder + 0.49
    hosts = ["*"]  # noqa: RUF012

    def process(self, context):
        """Remove what was extracted and not integrated."""
        for instance in context:
            if "usdfaceExtracted" in instance.data and "usdfacePublished" not in instance.data:
                instance.data["usdfaceExtracted"].discard()
