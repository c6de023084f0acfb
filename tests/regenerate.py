"""Regenerate what is derived from one source: USD schema files, JSON Schemas, reference pages.

`poe schemas` writes them into the repository; a test writes them elsewhere and compares.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.reference_pages import reference_pages
from usdface.specs.job import STEP_SPECS, JobSpec

REPOSITORY = Path(__file__).resolve().parents[1]
USD_SCHEMA = REPOSITORY / "schemas" / "usdface"
JSON_SCHEMAS = REPOSITORY / "schemas" / "json"
REFERENCE = REPOSITORY / "docs" / "reference"
PLUG_INFO_TOKENS = {
    "@PLUG_INFO_LIBRARY_PATH@": "",
    "@PLUG_INFO_RESOURCE_PATH@": ".",
    "@PLUG_INFO_ROOT@": ".",
}


def usd_schema() -> dict[str, str]:
    """Return generatedSchema.usda and plugInfo.json as USD's own generator makes them."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [
                sys.executable,
                "-m",
                "pxr.Usd.usdGenSchema",
                str(USD_SCHEMA / "schema.usda"),
                folder,
            ],
            check=True,
            capture_output=True,
        )
        files = {
            name: (Path(folder) / name).read_text(encoding="utf-8")
            for name in ("generatedSchema.usda", "plugInfo.json")
        }
    for token, value in PLUG_INFO_TOKENS.items():
        files["plugInfo.json"] = files["plugInfo.json"].replace(token, value)
    # The generator leaves blanks at line ends, which editors and git would strip.
    return {
        name: "\n".join(line.rstrip() for line in text.splitlines()) + "\n"
        for name, text in files.items()
    }


def json_schemas() -> dict[str, str]:
    """Return the JSON Schema of a job and of every step's spec, by file name."""
    specs = {"job": JobSpec} | {spec.model_fields["step"].default: spec for spec in STEP_SPECS}
    return {
        f"{name}.schema.json": json.dumps(spec.model_json_schema(), indent=2) + "\n"
        for name, spec in specs.items()
    }


def main() -> None:
    """Write every generated file into the repository."""
    for name, text in usd_schema().items():
        (USD_SCHEMA / name).write_text(text, encoding="utf-8")
    for old in JSON_SCHEMAS.glob("*.json"):
        old.unlink()
    for name, text in json_schemas().items():
        (JSON_SCHEMAS / name).write_text(text, encoding="utf-8")
    for old in REFERENCE.rglob("*.md"):
        old.unlink()
    for name, text in reference_pages(USD_SCHEMA / "schema.usda").items():
        (REFERENCE / name).parent.mkdir(parents=True, exist_ok=True)
        (REFERENCE / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
