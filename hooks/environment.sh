# Source this in bash, zsh or dash: sets the paths of usdface's hooks and schemas for DCCs and publish tools.
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

# Only for hosts whose Python has usdface: in others, USD fails to load the validators.
# They are next to the hooks in a wheel, below pipeline/ in a checkout.
for USDFACE_PLUGIN in schemas/usdface usdio/checks pipeline/usdface/usdio/checks; do
    [ -f "$USDFACE_HOOKS/../$USDFACE_PLUGIN/plugInfo.json" ] || continue
    USDFACE_PLUGIN=$(cd "$USDFACE_HOOKS/../$USDFACE_PLUGIN" && pwd)
    case ":${PXR_PLUGINPATH_NAME:-}:" in
        *":$USDFACE_PLUGIN:"*) ;;
        *) export PXR_PLUGINPATH_NAME="$USDFACE_PLUGIN${PXR_PLUGINPATH_NAME:+:$PXR_PLUGINPATH_NAME}" ;;
    esac
done
unset USDFACE_PLUGIN
