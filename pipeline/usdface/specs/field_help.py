"""What a spec's fields are for: the text beneath each, read where help or a schema is asked for."""

import ast
import functools
import inspect
import itertools
import textwrap


@functools.cache
def field_help(spec: type) -> dict[str, str]:
    """Return the text that stands beneath each field of a class, those it inherits included.

    Pydantic would read the source of every spec whenever a command starts. Where the package was
    installed without its source there is no help, and all else works.

    Parameters
    ----------
    spec : type
    """
    found: dict[str, str] = {}
    for each in reversed(spec.__mro__):
        if each.__module__.startswith(__package__):
            found |= _own_help(each)
    return found


def _own_help(spec: type) -> dict[str, str]:
    try:
        source = inspect.getsource(spec)
    except OSError:
        return {}
    (tree,) = ast.parse(textwrap.dedent(source)).body
    assert isinstance(tree, ast.ClassDef)
    return {
        field.target.id: inspect.cleandoc(text.value.value)
        for field, text in itertools.pairwise(tree.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }
