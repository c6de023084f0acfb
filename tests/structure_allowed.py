"""Exceptions from the rules of `tests.structure`, by rule and place, each with its reason."""

ALLOWED: dict[str, dict[str, str]] = {
    "long function": {
        "demo/cage:_grid_guess": "rows of coordinates laid by hand, from neck to crown",
        "demo/cage:lay_mouth": "rings of coordinates laid by hand, from outside to inside",
        "demo/capture:demo_markers": "a list of places on the face, one after the other",
    },
    "small file": {
        "tuning/poses": "a file of poses; the server beside it is as long as a file may be",
        "model/regressions/additive": "every regression is a file of its own, as its neighbours",
    },
}
