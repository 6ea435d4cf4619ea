"""Pictures as arrays: reading, and checking what callers hand over."""

import os
import warnings

import numpy as np

from wrod.errors import PerceptionError, needed_extras
from wrod.files import checked_path

# Most pixels of a picture: three times those of a phone; tracing them needs 2 GiB.
LARGEST = 36_000_000
_MOST_BYTES = 256 * 2**20
# Pillow's other readers run other programs, or are as old as they are unwatched.
_FORMATS = ("JPEG", "PNG", "TIFF", "BMP", "WEBP", "GIF", "PPM")
SMALLEST = 16  # shorter side below which no stroke can be told from noise [px]


@needed_extras()
def read_image(path: str | os.PathLike[str]) -> np.ndarray:
    """Picture file as (H, W, 3) RGB or (H, W) grey uint8, upright as its EXIF orientation says.

    16-bit grey pictures are scaled so that their brightest pixel is white; transparent pixels
    become white.

    Raises:
        PerceptionError: missing, truncated, not a picture, or smaller than 16 px.
    """
    from PIL import Image, ImageOps, UnidentifiedImageError

    checked_path(path, "a JPEG or PNG", error=PerceptionError, limit=_MOST_BYTES)
    try:
        with warnings.catch_warnings(), Image.open(path, formats=_FORMATS) as picture:
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # refused below
            width, height = picture.size
            if width * height > LARGEST:
                raise PerceptionError(
                    f"{path}: has {width} x {height} px, and at most {LARGEST / 1e6:.0f} million "
                    "are traced; scale it down"
                )
            if _has_more(picture):
                raise PerceptionError(
                    f"{path}: holds several pictures; save the one that is meant by itself"
                )
            picture = ImageOps.exif_transpose(picture)
            if picture.mode in ("RGBA", "LA", "PA") or "transparency" in picture.info:
                picture = picture.convert("RGBA")
                ground = Image.new("RGBA", picture.size, "white")
                picture = Image.alpha_composite(ground, picture).convert("RGB")
            if picture.mode == "1" or picture.mode.startswith(("I", "F")):
                array = np.array(picture)
            else:
                array = np.array(picture.convert("L" if picture.mode == "L" else "RGB"))
    except UnidentifiedImageError:
        raise PerceptionError(
            f"{path}: not a picture that can be read; give a JPEG or PNG"
        ) from None
    except PerceptionError:
        raise
    except Exception as error:  # each of Pillow's readers has its own
        raise PerceptionError(
            f"{path}: the picture is damaged or truncated ({error}); copy it again"
        ) from None
    return as_image(array, str(path))


def _has_more(picture) -> bool:
    """Whether there is a second picture; telephones put one for their screen behind a JPEG."""
    if picture.format in ("JPEG", "MPO"):
        return False
    try:
        picture.seek(1)
    except EOFError:
        return False
    return True


@needed_extras()
def picture_pixels(path: str | os.PathLike[str]) -> int:
    """Pixels that a picture promises; 0 where it cannot be read, which `read_image` says."""
    from PIL import Image

    try:
        checked_path(path, error=PerceptionError, limit=_MOST_BYTES)
        with warnings.catch_warnings(), Image.open(path, formats=_FORMATS) as picture:
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            return min(picture.width * picture.height, LARGEST)
    except Exception:  # whatever is wrong with it
        return 0


def as_image(image: np.ndarray, name: str = "the picture") -> np.ndarray:
    """`image` as contiguous uint8 (H, W) or RGB (H, W, 3).

    Args:
        image: bool, uint8, uint16 (scaled so that the brightest pixel is 255), or float in [0, 1].

    Raises:
        PerceptionError: other shapes or types, not finite, or smaller than 16 px.
    """
    image = np.asarray(image)
    if image.dtype.kind not in "buif":
        raise PerceptionError(f"{name}: holds {image.dtype} values; give bool, uint8, or float")
    if image.ndim in (2, 3) and image.shape[0] * image.shape[1] > LARGEST:
        raise PerceptionError(
            f"{name}: has {image.shape[1]} x {image.shape[0]} px, and at most "
            f"{LARGEST / 1e6:.0f} million are traced; scale it down"
        )
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
    """Whether a (H, W) array holds two values only, so that it already is a mask: the bright one on
    less than half, for more is paper under ink."""
    if image.dtype == bool or image.ndim != 2:
        return image.ndim == 2
    low, high = image.min(), image.max()
    bright, dark = (np.count_nonzero(image == value) for value in (high, low))
    return bool(low == high or (bright + dark == image.size and 2 * bright <= image.size))
