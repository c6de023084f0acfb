"""Rez: usdface as a package; `rez build --install` in this folder of a checkout installs it."""

name = "usdface"

version = "0.1.0"

description = "Facial capture to BlendShape weights, as a stage of an OpenUSD pipeline."

authors = ["usdface"]

requires = ["python-3.11+"]

tools = ["usdface"]

build_command = "python {root}/build.py"

with scope("config") as config:  # noqa: F821
    config.build_directory = "../../build/rez"  # outside of the wheel's sources


@early()  # noqa: F821
def variants():
    """Return the variant of compiled parts: the newest available Python, and this platform."""
    from rez.packages import get_latest_package
    from rez.system import system

    python = get_latest_package("python", range_="3.11+")
    here = (("platform", system.platform), ("arch", system.arch))
    made_for = [f"{kind}-{value}" for kind, value in here if get_latest_package(kind)]
    return [[*made_for, f"python-{python.version.trim(2)}"]] if python else []


def commands():
    """Set the paths of the package, its hooks and its schemas."""
    env.PYTHONPATH.append("{root}/python")  # noqa: F821
    env.PATH.append("{root}/python/bin")  # noqa: F821
    env.USDFACE_HOOKS = "{root}/python/usdface/hooks"  # noqa: F821
    env.PYBLISHPLUGINPATH.append("{root}/python/usdface/hooks/pyblish")  # noqa: F821
    env.PXR_PLUGINPATH_NAME.append("{root}/python/usdface/schemas/usdface")  # noqa: F821
    env.PXR_PLUGINPATH_NAME.append("{root}/python/usdface/usdio/checks")  # noqa: F821
