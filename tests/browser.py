"""A real browser for tests of pages; tests that need it skip, saying why, where there is none."""

import base64
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
import pytest

ARGUMENTS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-quic",
    "--no-first-run",
)
NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")
"""The shell has no windows, whose own pages take as long to load as ours."""


def find_chromium() -> str:
    """Return the path of a Chromium; the calling test skips without one."""
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip(f"no browser: none of {', '.join(NAMES)} is on the PATH")
    return found


@contextmanager
def chromium() -> Iterator[Any]:
    """Yield a running browser of playwright's Python API."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = find_chromium()
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        # Software draws the faces: at a quarter of the resolution it has a sixteenth of the pixels.
        for opened in ("new_page", "new_context"):
            coarse = partial(getattr(browser, opened), device_scale_factor=0.25)
            setattr(browser, opened, coarse)
        try:
            yield browser
        finally:
            browser.close()


def evaluate_array(page: Any, function: str, given: object = None) -> np.ndarray:
    """Return the typed array of a function in a page: ``Float32Array``, or of bytes.

    Its bytes come as text, since Playwright checks numbers one by one.
    """
    text, kind = page.evaluate(
        f"""(given) => {{
          const array = ({function})(given);
          const bytes = new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
          let text = "";
          for (let at = 0; at < bytes.length; at += 8192)
            text += String.fromCharCode(...bytes.subarray(at, at + 8192));
          return [btoa(text), array.BYTES_PER_ELEMENT === 4 ? "<f4" : "u1"];
        }}""",
        given,
    )
    return np.frombuffer(base64.b64decode(text), kind)
