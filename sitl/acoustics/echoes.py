"""How much comes back: amplitude of one echo over the source's pressure at 1 m (p0 = 1 at 1 m).

d1 and d2 are the distances from transmitter to reflection point and on to the receiver. Absorption, directivity and
reflectivity are factors of their own. With d1 = d2 = r these are the laws of acoustics.md, "Echo amplitude".
"""

import math

import numpy as np
from numba import njit

ROOT_PI = math.sqrt(math.pi)


@njit(cache=True)
def plane_amplitude(d1, d2):  # type: ignore[no-untyped-def]
    """Large plane: image source, 1 / (d1 + d2); 1/(2 r)."""
    return 1.0 / (d1 + d2)


@njit(cache=True)
def cylinder_amplitude(d1, d2, radius, cos_incidence):  # type: ignore[no-untyped-def]
    """Rigid cylinder, ka >> 1: ray-tube spreading in and across the plane of curvature; (1/2r) sqrt(a / (a + r)).

    In the plane across the axis the reflected front has the curvature 1/d1 + 2 / (a cos i), along the axis 1/d1.
    """
    bend = radius * cos_incidence
    across = bend * d1 / (bend * (d1 + d2) + 2.0 * d1 * d2)
    along = d1 / (d1 + d2)
    return math.sqrt(across * along) / d1


@njit(cache=True)
def sphere_amplitude(d1, d2, radius, cos_incidence):  # type: ignore[no-untyped-def]
    """Rigid sphere, ka >> 1: ray-tube spreading in the plane of incidence and across it; a / (2 r (r + a))."""
    bend, twist = radius * cos_incidence, radius / max(cos_incidence, 1e-3)
    inside = bend * d1 / (bend * (d1 + d2) + 2.0 * d1 * d2)
    across = twist * d1 / (twist * (d1 + d2) + 2.0 * d1 * d2)
    return math.sqrt(inside * across) / d1


@njit(cache=True)
def diffuse_amplitude(d1, d2, cos_in, cos_out, albedo, area):  # type: ignore[no-untyped-def]
    """One small patch of a rough surface by Lambert's law: sqrt(albedo cos i cos o dA / pi) / (d1 d2).

    `albedo` is the part of the arriving power that leaves diffusely. Patches lie many wavelengths apart, so their
    phases are as good as random: powers add, and the sum fades from place to place as speckle does.
    """
    return math.sqrt(max(albedo * cos_in * cos_out * area / math.pi, 0.0)) / (d1 * d2)


@njit(cache=True)
def edge_amplitude(d1, d2, cos_in, cos_out, wavenumber):  # type: ignore[no-untyped-def]
    """Hard half-plane edge (Keller 1962): (D/r) sqrt(1/2r), D = |1 + sec phi| / (2 sqrt(2 pi k)) in backscatter.

    phi is counted from the half-plane; cos_in and cos_out are its cosines for transmitter and receiver. Where the
    half-plane mirrors (phi + phi' = pi) the ray theory diverges: there the facet's own smooth border carries the
    echo, so the reflected term is faded by 1 - exp(-pi w^2), w being the distance of the mirror point from the edge
    in Fresnel radii. Signed; the diffracted phase is -exp(-j pi/4).
    """
    phi_in = math.acos(min(1.0, max(-1.0, cos_in)))
    phi_out = math.acos(min(1.0, max(-1.0, cos_out)))
    direct = 1.0 / math.cos(0.5 * (phi_in - phi_out))
    mirrored = math.cos(0.5 * (phi_in + phi_out))
    fade = 2.0 * wavenumber * d1 * d2 / (d1 + d2) * mirrored * mirrored
    reflected = 0.0 if abs(mirrored) < 1e-9 else (1.0 - math.exp(-fade)) / mirrored
    d = (direct + reflected) / (2.0 * math.sqrt(2.0 * math.pi * wavenumber))
    return d / math.sqrt(d1 * d2 * (d1 + d2))


@njit(cache=True)
def fresnel_radius(wavelength, d1, d2):  # type: ignore[no-untyped-def]
    """Radius R over which a mirror counts: sqrt(lambda d1 d2 / (d1 + d2)); sqrt(lambda r / 2)."""
    return math.sqrt(wavelength * d1 * d2 / (d1 + d2))


@njit(cache=True)
def arc_radius(wavelength, d1, d2, radius, cos_incidence):  # type: ignore[no-untyped-def]
    """The same along the arc of a cylinder, whose own curvature shortens it."""
    return math.sqrt(wavelength / (1.0 / d1 + 1.0 / d2 + 2.0 * cos_incidence / radius))


@njit(cache=True)
def mirror_share(low, high, radius):  # type: ignore[no-untyped-def]
    """Part of a mirror's echo that is left when it ends `low` metres to one side of the mirror point and `high` to
    the other (negative: the point lies beyond the end).

    Kirchhoff's integral of exp(j pi x^2 / R^2) / R with the Gaussian of the same area in place of the Fresnel kernel:
    1 deep inside, 1/2 at the border, (low + high) / R for a strip narrower than R, and no ripples (the edges' echoes
    are arrivals of their own).
    """
    return 0.5 * (math.erf(ROOT_PI * low / radius) + math.erf(ROOT_PI * high / radius))


@njit(cache=True)
def absorbed(path, neper_m):  # type: ignore[no-untyped-def]
    """Factor of the amplitude that is left after `path` metres of air."""
    return np.exp(-neper_m * path)
