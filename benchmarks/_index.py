"""Index of all measurements: claim, target, measured value, benchmark."""

import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

WANTED = ("wanted", "target")
MEASURED = ("measured", "value", "ratio", "CPU seconds", "of the bare write", "two at once")
"""Headings of the columns with targets, and of those that are compared with them."""

NUMBER = re.compile(r"[-+−]?\d[\d,]*(?:\.\d+)?(?:e-?\d+)?")


@dataclass(frozen=True)
class Claim:
    """A row of a benchmark with a target."""

    benchmark: str
    claim: str
    wanted: str
    measured: str
    met: bool | None


def claims(data: dict[str, Any]) -> list[Claim]:
    """Return the rows of a benchmark's tables with a target; `met` is None for targets in words.

    A bare number is an upper limit.
    """
    found = []
    for table in data["tables"]:
        for row in table:
            wanted = next((row[head] for head in WANTED if row.get(head)), "")
            measured = next((row[head] for head in MEASURED if row.get(head)), "")
            if wanted and measured:
                label = next(iter(row.values()))
                found.append(
                    Claim(data["benchmark"], label, wanted, measured, is_met(measured, wanted))
                )
    return found


def is_met(measured: str, wanted: str) -> bool | None:
    """Compare two cells: ``0.107 mm`` with ``< 0.3 mm``, ``12 of 12`` with ``≥ 95 %``."""
    limit, value = NUMBER.search(wanted), NUMBER.search(measured)
    if limit is None or value is None:
        return None
    target = float(limit.group().replace(",", "").replace("−", "-"))
    number = float(value.group().replace(",", "").replace("−", "-"))
    share = re.fullmatch(r"(\d+) of (\d+)", measured.strip())
    if share and "%" in wanted:
        number = 100 * float(share[1]) / float(share[2])
    sign = wanted.strip()[0]
    if sign in "≥>":
        return number >= target
    return number <= target if sign in "≤<" or sign.isdigit() else None


def write_index(folder: Path) -> None:
    """Write README.md and report.json of all results in a folder."""
    results = [
        json.loads(path.read_text(encoding="utf-8"))
        for path in sorted(folder.glob("*.json"))
        if path.stem != "report"
    ]
    all_claims = [claim for data in results for claim in claims(data)]
    text = [
        "# Measured",
        "",
        "One page per benchmark. `poe bench NAME --out docs/measured` writes it, this page, and",
        "`report.json` for scripts. Tables of accuracy are in [accuracy](../accuracy.md).",
        "",
        "## Claims",
        "",
        "| benchmark | claim | target | measured | met |",
        "|---|---|---|---|---|",
        *(
            f"| [{each.benchmark}]({each.benchmark}.md) | {each.claim} | {each.wanted} | "
            f"{each.measured} | {_yes_or_no(each.met)} |"
            for each in all_claims
        ),
        "",
        "## Runs",
        "",
        "| benchmark | date | duration [s] | load before | machine |",
        "|---|---|---|---|---|",
        *(
            f"| [{data['benchmark']}]({data['benchmark']}.md) | {data['date']} | "
            f"{data['seconds']:.0f} | {data['load_before']} | {data['machine']['processor']}, "
            f"{data['machine']['cores']} cores |"
            for data in results
        ),
        "",
    ]
    (folder / "README.md").write_text("\n".join(text), encoding="utf-8")
    report = {"claims": [asdict(each) for each in all_claims], "benchmarks": results}
    (folder / "report.json").write_text(
        json.dumps(report, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )


def _yes_or_no(met: bool | None) -> str:
    return {True: "yes", False: "**no**", None: ""}[met]
