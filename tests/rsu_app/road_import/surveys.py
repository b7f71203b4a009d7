"""Surveyed lines for tests, and the real ones that are only there on some machines."""

import csv
import gzip
import io
from pathlib import Path

import numpy as np
import pytest

ROADS = Path(__file__).resolve().parents[4] / "shared" / "data" / "roads"
needs_roads = pytest.mark.skipif(not ROADS.is_dir(), reason=f"no real roads at {ROADS}")

EAST_M, NORTH_M = 250_000.0, 6_834_000.0


def arc_points(radius_m: float = 80.0, turn_rad: float = 2.0, spacing_m: float = 10.0) -> np.ndarray:
    """Vertices on a left turn in UTM 33, rising 5 %, rounded to decimetres as registers do."""
    station = np.arange(0.0, radius_m * turn_rad, spacing_m)
    angle = station / radius_m
    rows = [EAST_M + radius_m * np.sin(angle), NORTH_M + radius_m * (1 - np.cos(angle)), 300.0 + 0.05 * station]
    return np.round(np.column_stack(rows), 1)


def wkt_of(points: np.ndarray, head: str = "LINESTRING Z (") -> str:
    return head + ", ".join(" ".join(f"{c:g}" if abs(c) < 1e5 else f"{c:.1f}" for c in p) for p in points) + ")"


def csv_of(points: np.ndarray, columns: str = "east_utm33,north_utm33,height") -> str:
    return "\n".join([columns, *(",".join(f"{c:.7f}" for c in p) for p in points)]) + "\n"


def ringebu_reference(name: str) -> dict[str, np.ndarray]:
    """The columns of one of the sections that were cut and fitted by somebody else."""
    rows = list(csv.DictReader(io.StringIO((ROADS / f"section_{name}.csv").read_text(encoding="utf-8"))))
    return {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}


def ringebu_vertices(name: str, margin_count: int = 8) -> np.ndarray:
    """The register's own vertices along one of those sections, with a few more at both ends."""
    reference = ringebu_reference(name)
    lines: dict[str, list[list[float]]] = {}
    with gzip.open(ROADS / "ringebu_vaerutsatt_centrelines.csv.gz", "rt", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            lines.setdefault(row["line"], []).append([float(row[k]) for k in ("east_utm33", "north_utm33", "height")])
    ends = [np.array([reference["east_utm33"][i], reference["north_utm33"][i]]) for i in (0, -1)]

    def away(points: np.ndarray, end: np.ndarray) -> np.ndarray:
        distance: np.ndarray = np.hypot(points[:, 0] - end[0], points[:, 1] - end[1])
        return distance

    points = min((np.array(v) for v in lines.values()), key=lambda p: away(p, ends[0]).min() + away(p, ends[1]).min())
    first, last = (int(np.argmin(away(points, end))) for end in ends)
    if first > last:
        points, first, last = points[::-1], len(points) - 1 - first, len(points) - 1 - last
    return points[max(0, first - margin_count) : last + margin_count + 1]
