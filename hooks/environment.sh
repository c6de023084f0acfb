# Source this in bash, zsh or dash: what DCCs and publish tools need to find usdface's hooks and schemas.
#     . "$(python3 -c 'import usdface, pathlib; print(pathlib.Path(usdface.__file__).parent)')/hooks/environment.sh"
# In a checkout: USDFACE_HOOKS=/path/to/hooks . /path/to/hooks/environment.sh

if [ -z "${USDFACE_HOOKS:-}" ]; then
    if [ -n "${BASH_SOURCE:-}" ]; then
        USDFACE_HOOKS=$(cd "$(dirname "$BASH_SOURCE")" && pwd)
    else
        USDFACE_HOOKS=$(python3 -c 'import usdface, pathlib; print(pathlib.Path(usdface.__file__).parent / "hooks")')
    fi
fi
export USDFACE_HOOKS

case ":${PYBLISHPLUGINPATH:-}:" in
    *":$USDFACE_HOOKS/pyblish:"*) ;;
    *) export PYBLISHPLUGINPATH="$USDFACE_HOOKS/pyblish${PYBLISHPLUGINPATH:+:$PYBLISHPLUGINPATH}" ;;
esac

USDFACE_SCHEMAS=$(cd "$USDFACE_HOOKS/../schemas/usdface" && pwd)
case ":${PXR_PLUGINPATH_NAME:-}:" in
    *":$USDFACE_SCHEMAS:"*) ;;
    *) export PXR_PLUGINPATH_NAME="$USDFACE_SCHEMAS${PXR_PLUGINPATH_NAME:+:$PXR_PLUGINPATH_NAME}" ;;
esac
unset USDFACE_SCHEMAS
