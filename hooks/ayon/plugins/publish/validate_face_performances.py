"""AYON: validate face performances."""

import pyblish.api
from ayon_core.pipeline import publish


class ValidateFacePerformance(pyblish.api.InstancePlugin):
    """Run USD's and usdface's validators; the report lists the errors."""

    label = "Validate face performance"
    order = pyblish.api.ValidatorOrder
    families = ["facePerformance"]  # noqa: RUF012

    def process(self, instance):
        """Validate the instance's performance."""
        from usdface.core.errors import UsdfaceError
        from usdface.publish import validate_performance

        try:
            findings = validate_performance(instance.data["usdfaceItem"])
        except UsdfaceError as error:
            raise publish.PublishValidationError(str(error), title="Face performance") from error
        errors = []
        for finding in findings:
            if finding.severity == "error":
                errors.append(f"- {finding.message} ({finding.check}, {finding.where})")
            else:
                self.log.warning("%s: %s", finding.where, finding.message)
        if errors:
            raise publish.PublishValidationError(
                f"{instance.data['usdfaceItem'].performance}: {len(errors)} errors",
                title="Face performance",
                description="\n".join(errors),
            )
