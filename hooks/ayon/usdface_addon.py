"""AYON: an add-on with usdface's publish plug-ins.

Copy this folder into an add-on as its client folder, or add its class to the studio's add-on. The
client folder must not be named usdface, because AYON imports it by name.
"""

from pathlib import Path

from ayon_core.addon import AYONAddon, IPluginPaths

PLUGINS = Path(__file__).resolve().parent / "plugins"


class UsdfaceAddon(AYONAddon, IPluginPaths):
    """Face performances in AYON's publisher."""

    name = "usdface"

    @property
    def version(self):
        """Version of the installed package."""
        from usdface.core.version import __version__

        return __version__

    def get_plugin_paths(self):
        """Return plug-in folders by kind, for AYON before 1.1."""
        return {"publish": self.get_publish_plugin_paths(None)}

    def get_publish_plugin_paths(self, host_name):
        """Return the folder of publish plug-ins, the same for all hosts."""
        return [str(PLUGINS / "publish")]
