"""The place of a map on earth: a plane of UTM, with its origin moved to the map's south-west corner."""

import math

import numpy as np
from jaxtyping import Complex128, Float64

Degrees = Float64[np.ndarray, " P"]
"""Latitudes or longitudes."""

# These are UTM's constants for the ellipsoid WGS 84. The series end at the third power of _N. The
# error is under a micrometre up to 7 km from the origin, and under 14 micrometres up to 100 km.
_N = 1 / (2 * 298.257223563 - 1)
_RADIUS = 0.9996 * 6378137 / (1 + _N) * (1 + _N**2 / 4 + _N**4 / 64)
_BETA = (_N / 2 - 2 * _N**2 / 3 + 37 * _N**3 / 96, _N**2 / 48 + _N**3 / 15, 17 * _N**3 / 480)
_DELTA = (2 * _N - 2 * _N**2 / 3 - 2 * _N**3, 7 * _N**2 / 3 - 8 * _N**3 / 5, 56 * _N**3 / 15)


def central_meridian(origin: tuple[float, float]) -> float:
    """Returns the longitude of the central meridian of the UTM zone of a latitude and longitude."""
    latitude, longitude = origin
    # The south-west of Norway belongs to zone 32.
    if 56 <= latitude < 64 and 3 <= longitude < 12:
        return 9.0
    return 6.0 * math.floor((longitude + 180) / 6) - 177


def plane_of(origin: tuple[float, float]) -> str:
    """Returns the plane of a map as PROJ writes it; `origin` is the place of x = y = 0."""
    corner = _on_plane(origin)
    # A false easting and northing move the origin of the plane.
    east, north = 0 - corner.real, 0 - corner.imag
    return (
        f"+proj=tmerc +lat_0=0 +lon_0={central_meridian(origin):g} +k=0.9996 "
        f"+x_0={east:.13g} +y_0={north:.13g} +datum=WGS84 +units=m"
    )


def to_earth(
    points: Complex128[np.ndarray, " P"], origin: tuple[float, float]
) -> tuple[Degrees, Degrees]:
    """Returns the latitudes and longitudes of points, x + y·i in metres from the origin."""
    latitudes, longitudes = _from_plane(points + _on_plane(origin))
    longitudes = central_meridian(origin) + longitudes
    # Maps may lie across the antimeridian, where OpenStreetMap's longitudes jump by 360.
    return latitudes, longitudes - 360 * np.round(longitudes / 360)


def _on_plane(origin: tuple[float, float]) -> complex:
    """Returns the place of a latitude and longitude on UTM's plane, x + y·i."""
    latitude, longitude = origin
    degree = math.radians(1) * _RADIUS
    place = 0j
    # The plane is turned by at most 0.05 radians against east and north, so each step leaves a
    # twentieth of the error.
    for _ in range(20):
        (latitude_here,), (longitude_here,) = _from_plane(np.array([place]))
        east = (longitude - central_meridian(origin) - longitude_here) * math.cos(
            math.radians(latitude)
        )
        place += degree * complex(east, latitude - latitude_here)
    return place


def _from_plane(points: Complex128[np.ndarray, " P"]) -> tuple[Degrees, Degrees]:
    """Returns the latitudes of points on UTM's plane, and the longitudes from its meridian.

    UTM is inverted by Krüger's series.
    """
    # `zeta` is the point on the plane: north as its real part, east as its imaginary part, in
    # radii.
    zeta = (points.imag + 1j * points.real) / _RADIUS
    # The first series leads to the transverse Mercator projection of a sphere.
    zeta = zeta - sum(beta * np.sin(2 * j * zeta) for j, beta in enumerate(_BETA, 1))
    # `chi` is the latitude on that sphere. The second series leads to the latitude on the
    # ellipsoid.
    chi = np.arcsin(np.sin(zeta.real) / np.cosh(zeta.imag))
    latitudes = chi + sum(delta * np.sin(2 * j * chi) for j, delta in enumerate(_DELTA, 1))
    # The sphere has the same longitudes.
    longitudes = np.arctan2(np.sinh(zeta.imag), np.cos(zeta.real))
    return np.degrees(latitudes), np.degrees(longitudes)
