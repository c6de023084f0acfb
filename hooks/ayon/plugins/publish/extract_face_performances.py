"""AYON: the files of a version, as representations that AYON's own integrator copies."""

from pathlib import Path

import pyblish.api
from ayon_core.pipeline import publish  # its classes by name would be found as plug-ins


class ExtractFacePerformance(publish.Extractor):
    """Make the weights layer, edits composed in, and a sheet.

    The layer stands alone, because AYON names files anew: sublayer or reference it over the
    character. The sheet becomes the version's thumbnail, a movie what is reviewed in AYON.
    """

    label = "Extract face performance"
    order = pyblish.api.ExtractorOrder
    families = ["facePerformance"]  # noqa: RUF012

    def process(self, instance):
        """Extract the instance."""
        from usdface.core.errors import UsdfaceError
        from usdface.publish import extract_performance

        try:
            extracted = extract_performance(
                instance.data["usdfaceItem"],
                Path(self.staging_dir(instance)),  # AYON removes it, and all that is in it
                review=instance.data.get("usdfaceReview"),
            )
        except UsdfaceError as error:
            raise publish.PublishError(str(error), title=self.label) from error
        self._add(instance, extracted, "weights", "usd")
        self._add(instance, extracted, "sheet", "sheet")
        self._add(instance, extracted, "movie", "review", ["review", "webreview"])
        sheet = extracted.path("sheet")
        if sheet is not None:
            instance.data.setdefault("thumbnailPath", str(sheet))

    def _add(self, instance, extracted, role, name, tags=()):
        path = extracted.path(role)
        if path is None:
            return
        representation = {
            "name": name,
            "ext": path.suffix[1:],
            "files": path.name,
            "stagingDir": str(extracted.folder),
        }
        if role != "weights":  # a thumbnail or review that AYON itself makes has the same suffix
            representation["outputName"] = name
        if tags:
            representation["tags"] = list(tags)
        if role == "movie":
            first = extracted.item.first_frame  # its rate is the video's, not the take's
            representation |= {
                "frameStart": first,
                "frameEnd": first + extracted.movie_pictures - 1,
                "fps": extracted.movie_rate,
            }
        instance.data.setdefault("representations", []).append(representation)
