"""Pictures as arrays: reading, and checking what callers hand over."""

from __future__ import annotations

import os

import numpy as np

from wrod.errors import PerceptionError

SMALLEST = 16  # shorter side below which no stroke can be told from noise [px]


def read_image(path: str | os.PathLike[str]) -> np.ndarray:
    """Picture file as (H, W, 3) RGB or (H, W) grey uint8, upright as its EXIF orientation says.

    16-bit grey pictures are scaled so that their brightest pixel is white; transparent pixels
    become white.

    Raises:
        PerceptionError: missing, truncated, not a picture, or smaller than 16 px.
    """
    from PIL import Image, ImageOps, UnidentifiedImageError

    try:
        with Image.open(path) as picture:
            picture = ImageOps.exif_transpose(picture)
            if picture.mode in ("RGBA", "LA", "PA") or "transparency" in picture.info:
                picture = picture.convert("RGBA")
                ground = Image.new("RGBA", picture.size, "white")
                picture = Image.alpha_composite(ground, picture).convert("RGB")
            if picture.mode == "1" or picture.mode.startswith(("I", "F")):
                array = np.array(picture)
            else:
                array = np.array(picture.convert("L" if picture.mode == "L" else "RGB"))
    except FileNotFoundError:
        raise PerceptionError(f"{path}: no such picture") from None
    except UnidentifiedImageError:
        raise PerceptionError(
            f"{path}: not a picture that can be read; give a JPEG or PNG"
        ) from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise PerceptionError(
            f"{path}: the picture is damaged or truncated ({error}); copy it again"
        ) from None
    return as_image(array, str(path))


def as_image(image: np.ndarray, name: str = "the picture") -> np.ndarray:
    """`image` as contiguous uint8 (H, W) or RGB (H, W, 3).

    Args:
        image: bool, uint8, uint16 (scaled so that the brightest pixel is 255), or float in [0, 1].

    Raises:
        PerceptionError: other shapes or types, not finite, or smaller than 16 px.
    """
    image = np.asarray(image)
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (3, 4)):
        raise PerceptionError(f"{name}: shape {image.shape}; give (H, W) grey or (H, W, 3) RGB")
    if min(image.shape[:2]) < SMALLEST:
        height, width = image.shape[:2]
        raise PerceptionError(
            f"{name}: {width} x {height} px is too small; at least {SMALLEST} x {SMALLEST} px"
        )
    image = image[..., :3] if image.ndim == 3 else image
    if image.dtype == bool:
        image = image.astype(np.uint8) * np.uint8(255)
    elif image.dtype != np.uint8:
        values = image.astype(float)
        if not np.isfinite(values).all() or values.min() < 0:
            raise PerceptionError(f"{name}: holds negative or not finite values")
        top = 1.0 if image.dtype.kind == "f" and values.max() <= 1.0 else max(values.max(), 255.0)
        image = np.round(values * (255.0 / top)).astype(np.uint8)
    return np.ascontiguousarray(image)


def is_mask(image: np.ndarray) -> bool:
    """Whether a (H, W) array holds two values only, so that it already is a mask."""
    if image.dtype == bool:
        return image.ndim == 2
    if image.ndim != 2:
        return False
    low, high = image.min(), image.max()
    return bool(((image == low) | (image == high)).all())
