"""Exceptions from the rules of `tests.structure`, by rule and place, each with its reason."""

ALLOWED: dict[str, dict[str, str]] = {
    "long function": {
        "demo/cage_grid:_grid_guess": "rows of coordinates laid by hand, from neck to crown",
        "demo/cage_rings:lay_mouth": "rings of coordinates laid by hand, from outside to inside",
        "demo/markers:demo_markers": "a list of places on the face, one after the other",
    },
    "small file": {
        "model/regressions/additive": "every regression is a file of its own, as its neighbours",
    },
}
