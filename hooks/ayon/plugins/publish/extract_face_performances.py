"""AYON: extract the files of a version as representations for AYON's integrator."""

from pathlib import Path

import pyblish.api
from ayon_core.pipeline import publish  # imported classes would be taken for plug-ins


class ExtractFacePerformance(publish.Extractor):
    """Make the weights layer with edits, those of head and controls, and a sheet.

    The layers have no references, because AYON renames files: sublayer or reference them over the
    character, the weights as the weakest. The sheet becomes the version's thumbnail, a movie its
    review.
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
                Path(self.staging_dir(instance)),  # removed by AYON
                review=instance.data.get("usdfaceReview"),
            )
        except UsdfaceError as error:
            raise publish.PublishError(str(error), title=self.label) from error
        self._add(instance, extracted, "weights", "usd")
        for role in ("head", "controls", "sheet"):
            self._add(instance, extracted, role, role)
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
        if role != "weights":  # AYON's own thumbnail or review has the same suffix
            representation["outputName"] = name
        if tags:
            representation["tags"] = list(tags)
        if role == "movie":
            first = extracted.item.first_frame  # at the rate of the video, not of the take
            representation |= {
                "frameStart": first,
                "frameEnd": first + extracted.movie_pictures - 1,
                "fps": extracted.movie_rate,
            }
        instance.data.setdefault("representations", []).append(representation)
