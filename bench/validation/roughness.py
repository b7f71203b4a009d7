"""The road surface: its spectrum inside its class of ISO 8608, and the coherence of both wheel tracks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import csd, welch

from bench.validation.picture import BAND, OURS, QUIET, SERIES, THEORY, label, line, name, panels, plain_log_axes, write
from roadgrip.units import FloatArray
from vehicle_client.simulator.plan import RoughnessClass
from vehicle_client.simulator.surface import GRID_M, class_density_m3, isotropic_coherence_ratio, roughness_m

CLASSES = (RoughnessClass.A, RoughnessClass.B, RoughnessClass.C, RoughnessClass.D)
LENGTH_M = 40_000.0
SEGMENT_COUNT = 4096
REFERENCE_1PM = 0.1
LOWEST_1PM, HIGHEST_1PM = 0.011, 2.83
"""Wave numbers for which the standard states the classes."""
SEED = 8


def draw(folder: Path) -> dict[str, Any]:
    """Draw the picture of the surface and return its figures.

    Args:
        folder: Where pictures go.
    """
    figure, axes = panels(1, 2, title="Road surface, ISO 8608")
    figures: dict[str, Any] = {}
    tracks = None
    for seed, (roughness, colour) in enumerate(
        zip(CLASSES, (SERIES[0], SERIES[1], SERIES[3], SERIES[4]), strict=True), SEED
    ):
        density = class_density_m3(roughness)
        drawn = roughness_m(np.random.default_rng(seed), length_m=LENGTH_M, density_m3=density)
        tracks = drawn if tracks is None else tracks
        wave, found = _spectrum(drawn)
        fine = np.geomspace(LOWEST_1PM, HIGHEST_1PM, 50)
        middle = density * (fine / REFERENCE_1PM) ** -2
        axes[0].fill_between(fine, 0.5 * middle, 2.0 * middle, color=BAND, alpha=0.45, linewidth=0)
        line(axes[0], wave, found, colour, linewidth=1.2)
        name(axes[0], wave[2], found[2], roughness.value.upper(), colour, xytext=(-12, 0), fontsize=10)
        over = found / (density * (wave / REFERENCE_1PM) ** -2)
        stated = (wave >= LOWEST_1PM) & (wave <= HIGHEST_1PM)
        figures[f"class_{roughness.value}"] = {
            "lowest_over_middle_ratio": float(over[stated].min()),
            "highest_over_middle_ratio": float(over[stated].max()),
            "inside_band_frac": float(((over[stated] > 0.5) & (over[stated] < 2.0)).mean()),
        }
    plain_log_axes(axes[0], x=True, y=True)
    label(axes[0], "Displacement spectrum; bands: classes", x="wave number, cycles per m", y="m³")

    assert tracks is not None  # noqa: S101 - there is a class
    wave, found = _coherence(tracks)
    wanted = isotropic_coherence_ratio(wave)
    line(axes[1], wave, wanted, THEORY, linestyle="--")
    axes[1].plot(wave, found, "o", color=OURS, ms=3.5)
    name(axes[1], 0.2, float(np.interp(0.2, wave, wanted)), "isotropic surface", THEORY, xytext=(10, 6))
    name(axes[1], 0.02, 0.25, "generated", OURS)
    axes[1].axhline(0.0, color=QUIET, linewidth=0.8)
    plain_log_axes(axes[1], x=True)
    label(axes[1], "Left against right wheel track", x="wave number, cycles per m", y="cross spectrum / spectrum")
    figures["cross_spectrum_largest_error"] = float(np.abs(found - wanted).max())
    return figures | {"picture": write(figure, folder, "roughness")}


def _in_bands(wave: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return means over sixths of an octave; the lowest wave numbers stay single."""
    edges = np.geomspace(LOWEST_1PM, HIGHEST_1PM, 49)
    index = np.digitize(wave, edges)
    bands = [k for k in range(1, len(edges)) if (index == k).any()]
    return np.array([wave[index == k].mean() for k in bands]), np.array([values[index == k].mean() for k in bands])


def _spectrum(tracks: FloatArray) -> tuple[FloatArray, FloatArray]:
    # The slope is nearly white, so that the window leaks nothing from the long waves into the short ones.
    slope = np.diff(tracks, axis=0) / GRID_M
    wave, density = welch(slope, fs=1.0 / GRID_M, nperseg=SEGMENT_COUNT, axis=0)
    gain = 2.0 * np.sin(np.pi * wave * GRID_M) / GRID_M
    return _in_bands(wave[1:], density[1:].mean(axis=1) / gain[1:] ** 2)


def _coherence(tracks: FloatArray) -> tuple[FloatArray, FloatArray]:
    slope = np.diff(tracks, axis=0)
    wave, cross = csd(slope[:, 0], slope[:, 1], fs=1.0 / GRID_M, nperseg=SEGMENT_COUNT)
    _, own = welch(slope, fs=1.0 / GRID_M, nperseg=SEGMENT_COUNT, axis=0)
    at, ratio = _in_bands(wave[1:], cross.real[1:] / own[1:].mean(axis=1))
    return at, ratio
