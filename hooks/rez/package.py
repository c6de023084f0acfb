"""Rez: usdface as a package; `rez build --install` in this folder of a checkout installs it."""

name = "usdface"

version = "0.1.0"

description = "Facial capture to BlendShape weights, as a stage of an OpenUSD pipeline."

authors = ["usdface"]

requires = ["python-3.11+"]

tools = ["usdface"]

build_command = "python -m pip install --no-compile --target {install_path}/python {root}/../.."


def commands():
    """Set what a shell needs to find the package, its hooks and its schemas."""
    env.PYTHONPATH.append("{root}/python")  # noqa: F821
    env.PATH.append("{root}/python/bin")  # noqa: F821
    env.USDFACE_HOOKS = "{root}/python/usdface/hooks"  # noqa: F821
    env.PYBLISHPLUGINPATH.append("{root}/python/usdface/hooks/pyblish")  # noqa: F821
    env.PXR_PLUGINPATH_NAME.append("{root}/python/usdface/schemas/usdface")  # noqa: F821
    env.PXR_PLUGINPATH_NAME.append("{root}/python/usdface/usdio/checks")  # noqa: F821
