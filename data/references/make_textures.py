"""Draws the textures of the reference scenes: planet.png and stars.png, sRGB of 8 bits."""

from pathlib import Path

import numpy as np

from spheretrace_jax import write_image

HERE = Path(__file__).parent


def globe(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns azimuth and polar angle of every texel's centre, row 0 at the north pole."""
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    azimuth = 2 * np.pi * (np.arange(columns) + 0.5) / columns
    return azimuth[None, :], polar[:, None]


def planet() -> np.ndarray:
    """Draws two continents, an ice cap in the north only, and a meridian in red."""
    azimuth, polar = globe(32, 64)
    height = np.sin(2 * azimuth + 1) * np.sin(polar) + np.cos(3 * polar + np.sin(azimuth))
    land = np.broadcast_to((height > 0.4)[..., None], (32, 64, 3))
    color = (
        np.where(land, [0.25, 0.5, 0.1], [0.05, 0.15, 0.6])
        * (0.8 + 0.2 * np.sin(9 * polar))[..., None]
    )
    color[:4] = 0.9
    color[:, 10] = [0.8, 0.05, 0.05]
    return color


def stars() -> np.ndarray:
    """Draws a band of dust and 200 stars at seeded positions, every texel below 0.9."""
    random = np.random.default_rng(1)
    azimuth, polar = globe(64, 128)
    band = np.exp(-8 * (np.cos(polar) - 0.3 * np.sin(azimuth)) ** 2)
    color = band[..., None] * [0.25, 0.2, 0.3] + [0.02, 0.02, 0.06]
    texels = random.integers(64, size=200), random.integers(128, size=200)
    color[texels] = random.uniform(0.3, 0.9, (200, 1)) * random.uniform(0.7, 1.0, (200, 3))
    return color


if __name__ == "__main__":
    write_image(HERE / "planet.png", planet())
    write_image(HERE / "stars.png", stars())
