"""AYON: the add-on that tells AYON where usdface's publish plug-ins are.

Copy this folder into an add-on as its client folder, or make its class part of the studio's own
add-on. The client folder must not be called usdface: AYON imports it by its name.
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
        """Return plug-in folders by kind, as AYON before 1.1 asks for them."""
        return {"publish": self.get_publish_plugin_paths(None)}

    def get_publish_plugin_paths(self, host_name):
        """Return the folder of publish plug-ins; they are the same in every host."""
        return [str(PLUGINS / "publish")]
