"""Pyblish: validate face performances."""

import pyblish.api


class ValidateFacePerformance(pyblish.api.InstancePlugin):
    """Run USD's and usdface's validators; warnings are logged, errors stop the publish."""

    label = "Validate face performance"
    order = pyblish.api.ValidatorOrder
    families = ["facePerformance"]  # noqa: RUF012
    hosts = ["*"]  # noqa: RUF012

    def process(self, instance):
        """Validate the instance's performance."""
        from usdface.core.errors import CheckFailedError
        from usdface.publish import validate_performance

        errors = []
        for finding in validate_performance(instance.data["usdfaceItem"]):
            line = f"{finding.where}: {finding.message} [{finding.check}]"
            if finding.severity == "error":
                errors.append(line)
            else:
                self.log.warning(line)
        if errors:
            raise CheckFailedError("\n".join(errors))
