"""`make deb-bill`: what the packages in `dist/` weigh; docs/results/install.json, and the table in docs/install.md."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import tarfile
from pathlib import Path
from typing import Any

from deploy.debian.build import DOCUMENTS, ROOT
from training.marked_tables import table, with_tables

RESULTS = ROOT / "docs" / "results" / "install.json"
PAGE = ROOT / "docs" / "install.md"
NAMED_COUNT = 8
"""Distributions that the bill names; the others are one line."""
TABLE_NAME = "bill"


def bill_of(package: Path) -> dict[str, Any]:
    """Return what a package weighs and what of it is whose."""
    fields = {name: _field(package, name) for name in ("Architecture", "Version", "Depends")}
    packed = subprocess.run(
        ["dpkg-deb", "--fsys-tarfile", str(package)],  # noqa: S607 - whichever dpkg there is
        capture_output=True,
        check=True,
    )
    with tarfile.open(fileobj=io.BytesIO(packed.stdout)) as tree:
        installed_bytes = sum(member.size for member in tree if member.isreg())
        content = tree.extractfile(f"./{DOCUMENTS}/contents.json")
        contents = json.loads(content.read() if content is not None else b"[]")
    return {
        "architecture": fields["Architecture"],
        "version": fields["Version"],
        "depends": fields["Depends"],
        "package_mb": round(package.stat().st_size / 1e6, 1),
        "install_mb": round(installed_bytes / 1e6, 1),
        "parts": [{**part, "size_mb": round(part.pop("size_bytes") / 1e6, 2)} for part in contents],
    }


def bill_table(bills: list[dict[str, Any]]) -> str:
    """Return the bills side by side as Markdown, in megabytes."""
    sizes = [{part["name"]: part["size_mb"] for part in bill["parts"]} for bill in bills]
    names = sorted(sizes[0], key=lambda name: -sizes[0][name])[:NAMED_COUNT]
    rows = [[f"`{name}`", *(f"{size.get(name, 0.0):.1f}" for size in sizes)] for name in names]
    others = [sum(size.values()) - sum(size.get(name, 0.0) for name in names) for size in sizes]
    rows.append([f"{len(sizes[0]) - len(names)} others", *(f"{other_mb:.1f}" for other_mb in others)])
    rest = [bill["install_mb"] - sum(size.values()) for bill, size in zip(bills, sizes, strict=True)]
    rows.append(["settings, unit, documents", *(f"{max(rest_mb, 0.0):.1f}" for rest_mb in rest)])
    rows.append(["**installed**", *(f"**{bill['install_mb']:.1f}**" for bill in bills)])
    rows.append(["the package itself", *(f"{bill['package_mb']:.1f}" for bill in bills)])
    return table(["MB", *(f"`{bill['architecture']}`" for bill in bills)], rows)


def _field(package: Path, name: str) -> str:
    done = subprocess.run(
        ["dpkg-deb", "--field", str(package), name],  # noqa: S607 - whichever dpkg there is
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def main() -> int:
    """Return 0 after the bill was made from the newest package of each architecture."""
    packages = sorted((ROOT / "dist").glob("roadgrip-rsu_*.deb"), key=lambda path: path.stat().st_mtime)
    newest = {_field(package, "Architecture"): package for package in packages}
    if not newest:
        print("deb-bill: dist/ holds no package; `make deb` makes one", file=sys.stderr)
        return 1
    bills = [bill_of(newest[architecture]) for architecture in sorted(newest)]
    RESULTS.write_text(json.dumps(bills, indent=1) + "\n", encoding="utf-8")
    made = bill_table(bills)
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(with_tables(page, {TABLE_NAME: made}.get), encoding="utf-8")
    print(made)
    return 0


if __name__ == "__main__":
    sys.exit(main())
