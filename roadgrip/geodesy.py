"""Where metres on a plane meet latitude and longitude; the only module that knows both.

The plane of a section is that of its map projection (grid metres): in UTM a grid metre is 0.9996 to 1.0010 ground
metres, so a section of 600 m may be 0.2 to 0.6 m shorter or longer than what a wheel would measure. `GeoFrame` finds
the scale from the section's anchors, so positions do not suffer.

WGS 84 and GRS 80 differ by a tenth of a millimetre and are taken for the same. ETRS 89 is taken for WGS 84; the
continents have drifted apart by some 0.8 m since 1989, which is below what a vehicle's receiver knows.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import SectionError
from roadgrip.section import GnssAnchor, RoadSection

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from roadgrip.units import FloatArray

SEMI_MAJOR_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
UTM_SCALE = 0.9996
UTM_FALSE_EASTING_M = 500_000.0
LATITUDE_LIMIT_DEG = 84.0
"""UTM ends here; so do roads."""
MERIDIAN_DISTANCE_LIMIT_DEG = 40.0
"""Farther from the central meridian the series is not trusted to a millimetre."""
ANCHOR_STEP_M = 100.0
_FRAME_RESIDUAL_LIMIT_M = 5.0
_FRAME_SCALE_LIMIT = 0.02
_ANCHOR_SPREAD_LIMIT_M = 10.0

_N = FLATTENING / (2.0 - FLATTENING)
_ECCENTRICITY = float(np.sqrt(FLATTENING * (2.0 - FLATTENING)))
_RECTIFYING_RADIUS_M = SEMI_MAJOR_M / (1.0 + _N) * (1.0 + _N**2 / 4.0 + _N**4 / 64.0)
_ALPHA = (
    _N / 2.0 - 2.0 / 3.0 * _N**2 + 5.0 / 16.0 * _N**3 + 41.0 / 180.0 * _N**4,
    13.0 / 48.0 * _N**2 - 3.0 / 5.0 * _N**3 + 557.0 / 1440.0 * _N**4,
    61.0 / 240.0 * _N**3 - 103.0 / 140.0 * _N**4,
    49561.0 / 161280.0 * _N**4,
)
_BETA = (
    _N / 2.0 - 2.0 / 3.0 * _N**2 + 37.0 / 96.0 * _N**3 - 1.0 / 360.0 * _N**4,
    1.0 / 48.0 * _N**2 + 1.0 / 15.0 * _N**3 - 437.0 / 1440.0 * _N**4,
    17.0 / 480.0 * _N**3 - 37.0 / 840.0 * _N**4,
    4397.0 / 161280.0 * _N**4,
)
_DELTA = (
    2.0 * _N - 2.0 / 3.0 * _N**2 - 2.0 * _N**3 + 116.0 / 45.0 * _N**4,
    7.0 / 3.0 * _N**2 - 8.0 / 5.0 * _N**3 - 227.0 / 45.0 * _N**4,
    56.0 / 15.0 * _N**3 - 136.0 / 35.0 * _N**4,
    4279.0 / 630.0 * _N**4,
)

_UTM_CODES = (
    (25828, 25838, 28),  # ETRS89 / UTM zone 28N..38N
    (32601, 32660, 1),  # WGS 84 / UTM zone 1N..60N
    (6171, 6176, 31),  # ETRS89 / UTM zone 31N..36N + NN54 height
    (5971, 5976, 31),  # ETRS89 / UTM zone 31N..36N + NN2000 height; 5973 is what NVDB answers in
)
GEOGRAPHIC_CODES = frozenset({"EPSG:4326", "EPSG:4258", "EPSG:4979", "EPSG:4937"})
"""Coordinate references in degrees: WGS 84 and ETRS89, flat and with height."""


def utm_zone_of_crs(crs: str) -> int:
    """Return the zone of a northern UTM coordinate reference such as "EPSG:25833".

    Known are ETRS89 and WGS 84 in UTM, also in compound with Norwegian heights (EPSG:5973).

    Raises:
        SectionError: It is not one of them; "local" is not either.
    """
    match = re.fullmatch(r"EPSG:(\d{4,5})", crs, re.IGNORECASE | re.ASCII)
    code = int(match.group(1)) if match else 0
    for first, last, zone in _UTM_CODES:
        if first <= code <= last:
            return zone + code - first
    message = f"coordinate reference {crs[:40]!r} is no northern UTM zone such as EPSG:25833 or EPSG:5973"
    raise SectionError(message)


def central_meridian_deg(zone: int) -> float:
    """Return the longitude in the middle of a UTM zone."""
    return 6.0 * zone - 183.0


def utm_to_lat_lon(east_m: ArrayLike, north_m: ArrayLike, *, zone: int) -> tuple[FloatArray, FloatArray]:
    """Return latitude and longitude in degrees of northern UTM coordinates.

    Good to a millimetre within 40 degrees of the central meridian. NaN in, NaN out.

    Args:
        east_m: With the false easting of 500 km. Any shape.
        north_m: Distance from the equator. Same shape.
        zone: UTM zone, 1 to 60.

    References:
        Krueger 1912 in the form of Karney, Transverse Mercator with an accuracy of a few nanometers, J. Geodesy 2011.
    """
    return _inverse(
        (np.asarray(east_m, dtype=np.float64) - UTM_FALSE_EASTING_M) / UTM_SCALE,
        np.asarray(north_m, dtype=np.float64) / UTM_SCALE,
        meridian_deg=central_meridian_deg(zone),
    )


def lat_lon_to_utm(lat_deg: ArrayLike, lon_deg: ArrayLike, *, zone: int) -> tuple[FloatArray, FloatArray]:
    """Return northern UTM east and north in metres.

    NaN in, NaN out; NaN too above 84 degrees or farther than 40 degrees from the central meridian.

    Args:
        lat_deg: Any shape.
        lon_deg: Same shape.
        zone: UTM zone, 1 to 60; may be a neighbouring one.
    """
    east, north = _forward(lat_deg, lon_deg, meridian_deg=central_meridian_deg(zone))
    return UTM_SCALE * east + UTM_FALSE_EASTING_M, UTM_SCALE * north


def utm_zone_of_lon(lon_deg: float) -> int:
    """Return the UTM zone a longitude lies in, without the exceptions around Norway and Svalbard."""
    return int((lon_deg + 180.0) // 6.0) % 60 + 1


@dataclass(frozen=True, slots=True)
class GeoFrame:
    """The similarity between geographic coordinates and the plane of one section.

    Attributes:
        meridian_deg: Central meridian of the auxiliary transverse Mercator plane, through the anchors.
        centre_m: Centre of the anchors in the auxiliary plane.
        local_centre_m: The same point in the section's plane.
        cos_scale: Scale times cosine of the rotation from the auxiliary plane to the section's.
        sin_scale: Scale times sine of it.
        residual_m: Root mean square of what the anchors disagree by.
    """

    meridian_deg: float
    centre_m: tuple[float, float]
    local_centre_m: tuple[float, float]
    cos_scale: float
    sin_scale: float
    residual_m: float

    def to_local(self, lat_deg: ArrayLike, lon_deg: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return x (east) and y (north) in metres on the plane of the section's nodes. NaN in, NaN out."""
        east, north = _forward(lat_deg, lon_deg, meridian_deg=self.meridian_deg)
        u, v = east - self.centre_m[0], north - self.centre_m[1]
        x = self.local_centre_m[0] + self.cos_scale * u - self.sin_scale * v
        y = self.local_centre_m[1] + self.sin_scale * u + self.cos_scale * v
        return x, y

    def to_lat_lon(self, x_m: ArrayLike, y_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return latitude and longitude in degrees of points on the section's plane. NaN in, NaN out."""
        u = np.asarray(x_m, dtype=np.float64) - self.local_centre_m[0]
        v = np.asarray(y_m, dtype=np.float64) - self.local_centre_m[1]
        square = self.cos_scale**2 + self.sin_scale**2
        east = self.centre_m[0] + (self.cos_scale * u + self.sin_scale * v) / square
        north = self.centre_m[1] + (self.cos_scale * v - self.sin_scale * u) / square
        return _inverse(east, north, meridian_deg=self.meridian_deg)


@lru_cache(maxsize=8)
def frame_of(section: RoadSection) -> GeoFrame:
    """Return the frame that fits a section's anchors best: rotation, scale and offset by least squares.

    Kept for the last few sections that were asked for. Two anchors suffice. Over a section of 1 km positions agree with
    the map's own projection to centimetres; the rounding of anchors (1e-7 degrees, 0.1 m of station) is what remains.

    Raises:
        SectionError: There are fewer than two anchors, they coincide, or they contradict the centre line.

    References:
        Umeyama, Least-squares estimation of transformation parameters between two point patterns, 1991, in the plane.
    """
    anchors = section.anchors
    if len(anchors) < 2:
        message = f"section {section.section_id!r} has {len(anchors)} GNSS anchors; a position needs at least 2"
        raise SectionError(message)
    lat = np.array([a.lat_deg for a in anchors])
    lon = np.array([a.lon_deg for a in anchors])
    meridian = float(lon[0])
    station = np.array([a.station_m for a in anchors])
    profile = section.profile
    local = np.interp(station, profile.station_m, profile.x_m) + 1j * np.interp(station, profile.station_m, profile.y_m)
    east, north = _forward(lat, lon, meridian_deg=meridian)
    plane = east + 1j * north
    centre, local_centre = plane.mean(), local.mean()
    spread = float(np.sum(np.abs(plane - centre) ** 2))
    if not np.isfinite(spread) or np.sqrt(spread / len(anchors)) < _ANCHOR_SPREAD_LIMIT_M / 2.0:
        message = f"section {section.section_id!r}: its GNSS anchors coincide or are nowhere on Earth's roads"
        raise SectionError(message)
    gain = np.sum((local - local_centre) * np.conj(plane - centre)) / spread
    misfit = local - local_centre - gain * (plane - centre)
    residual = float(np.sqrt(np.mean(np.abs(misfit) ** 2)))
    if residual > _FRAME_RESIDUAL_LIMIT_M or abs(abs(gain) - 1.0) > _FRAME_SCALE_LIMIT:
        message = (
            f"section {section.section_id!r}: its GNSS anchors contradict the centre line "
            f"(residual {residual:.1f} m, scale {abs(gain):.4f})"
        )
        raise SectionError(message)
    return GeoFrame(
        meridian_deg=meridian,
        centre_m=(float(centre.real), float(centre.imag)),
        local_centre_m=(float(local_centre.real), float(local_centre.imag)),
        cos_scale=float(gain.real),
        sin_scale=float(gain.imag),
        residual_m=residual,
    )


def anchors_of(section: RoadSection, *, step_m: float = ANCHOR_STEP_M) -> tuple[GnssAnchor, ...]:
    """Return anchors at the start, at the end and about every `step_m` between, from the section's own reference.

    Put them in with `dataclasses.replace(section, anchors=...)`; they are already rounded to what the wire carries.

    Raises:
        SectionError: The section's coordinate reference is not UTM.
    """
    zone = utm_zone_of_crs(section.crs)
    # Stations are kept to 0.1 m, so the points are taken where the rounded stations are.
    end = np.floor(section.length_m * 10.0) / 10.0
    pieces = max(1, round(end / step_m))
    station = np.round(np.linspace(0.0, end, pieces + 1), 1)
    profile = section.profile
    lat, lon = utm_to_lat_lon(
        section.origin_m[0] + np.interp(station, profile.station_m, profile.x_m),
        section.origin_m[1] + np.interp(station, profile.station_m, profile.y_m),
        zone=zone,
    )
    return tuple(
        GnssAnchor(round(float(s), 1), round(float(a), 7), round(float(o), 7))
        for s, a, o in zip(station, lat, lon, strict=True)
    )


def _forward(lat_deg: ArrayLike, lon_deg: ArrayLike, *, meridian_deg: float) -> tuple[FloatArray, FloatArray]:
    """Return east and north of the transverse Mercator plane with scale 1 on its meridian."""
    lat = np.asarray(lat_deg, dtype=np.float64)
    away = (np.asarray(lon_deg, dtype=np.float64) - meridian_deg + 180.0) % 360.0 - 180.0
    inside = (np.abs(lat) <= LATITUDE_LIMIT_DEG) & (np.abs(away) <= MERIDIAN_DISTANCE_LIMIT_DEG)
    phi = np.deg2rad(np.where(inside, lat, np.nan))
    lam = np.deg2rad(np.where(inside, away, np.nan))
    e = _ECCENTRICITY
    t = np.sinh(np.arctanh(np.sin(phi)) - e * np.arctanh(e * np.sin(phi)))
    xi = np.arctan2(t, np.cos(lam))
    eta = np.arctanh(np.sin(lam) / np.hypot(1.0, t))
    zeta = xi + 1j * eta
    plane = zeta + sum(a * np.sin(2 * j * zeta) for j, a in enumerate(_ALPHA, start=1))
    return _RECTIFYING_RADIUS_M * plane.imag, _RECTIFYING_RADIUS_M * plane.real


def _inverse(east_m: FloatArray, north_m: FloatArray, *, meridian_deg: float) -> tuple[FloatArray, FloatArray]:
    """Return latitude and longitude of the plane of `_forward`."""
    plane = (north_m + 1j * east_m) / _RECTIFYING_RADIUS_M
    # A point beyond the pole or a quarter of the globe away is no input of ours; NaN says so without overflow.
    plane = np.where((np.abs(plane.real) < np.pi / 2) & (np.abs(plane.imag) < 1.5), plane, np.nan + 1j * np.nan)
    zeta = plane - sum(b * np.sin(2 * j * plane) for j, b in enumerate(_BETA, start=1))
    xi, eta = zeta.real, zeta.imag
    chi = np.arcsin(np.clip(np.sin(xi) / np.cosh(eta), -1.0, 1.0))
    phi = chi + sum(d * np.sin(2 * j * chi) for j, d in enumerate(_DELTA, start=1))
    lam = np.arctan2(np.sinh(eta), np.cos(xi))
    lon = (meridian_deg + np.rad2deg(lam) + 180.0) % 360.0 - 180.0
    return np.rad2deg(phi), lon
